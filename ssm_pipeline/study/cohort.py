"""The masks a study is on: one call to the source its settings name."""

from __future__ import annotations

from pathlib import Path

from ssm_pipeline.records import Cohort, StudyError
from ssm_pipeline.study.settings import Luna16Data, MaskFolderData, PhantomData, StudySettings


def find_cohort(settings: StudySettings, run_folder: Path) -> Cohort:
    """Nothing is read before a case is loaded; phantoms are made in `<run>/data/phantoms`."""
    data = settings.data
    if isinstance(data, PhantomData):
        from data_prep.phantoms import make_cohort

        return make_cohort(run_folder / "data" / "phantoms", data)
    if data.folder is None:
        raise StudyError("no masks given. Pass --data FOLDER, or set data.folder.")
    options = {name: getattr(data, name) for name in ("cases", "limit", "allow_truncated")}
    if isinstance(data, Luna16Data):
        from data_prep import luna16

        return luna16.find_cases(data.folder, side=data.side, subset=data.subset, **options)
    assert isinstance(data, MaskFolderData)
    from data_prep import mask_folder

    return mask_folder.find_cases(
        data.folder, labels=data.labels, pattern=data.pattern, organ=data.organ, **options
    )


def what_a_case_rests_on(settings: StudySettings) -> dict[str, object]:
    """The data settings that change a case itself, and not which cases there are."""
    which = {"folder", "cases", "limit", "subset", "pattern", "organ"}
    if isinstance(settings.data, PhantomData):
        return {}  # the files say it all
    return settings.data.model_dump(mode="json", exclude=which)

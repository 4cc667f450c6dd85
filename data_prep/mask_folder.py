"""A folder of label images of any organ: one file a case, or one folder a case."""

from __future__ import annotations

from functools import partial
from pathlib import Path, PurePosixPath

from data_prep.image_files import image_stem, is_image
from data_prep.images import read_mask
from data_prep.selection import choose, unique_by_id
from ssm_pipeline.records import CaseSource, Cohort, StudyError


def find_cases(
    folder: Path,
    labels: tuple[int, ...] = (1,),
    pattern: str | None = None,
    organ: str = "organ",
    cases: tuple[str, ...] | None = None,
    limit: int | None = None,
    allow_truncated: bool = True,
) -> Cohort:
    """The label images of a folder; nothing is read before a case is loaded.

    labels   united to one organ: (1, 2) is a hippocampus of anterior and posterior part.
    pattern  a glob below `folder`; None: every label image directly in it. A pattern that ends
             in a plain file name, as TotalSegmentator's `*/liver.nii.gz`, takes the case id from
             the file's folder; any other takes it from the file name.
    Raises   StudyError if nothing matches, two files share one id, or a named case is missing.
    """
    if not folder.is_dir():
        raise StudyError(f"there is no folder {folder}. Give the folder that holds the masks.")
    found = folder.iterdir() if pattern is None else folder.glob(pattern)
    files = [path for path in found if is_image(path)]
    if not files:
        what = "label images (.nii.gz, .nii, .nrrd, .mhd, .mha)"
        matching = f" that match {pattern}" if pattern else ""
        raise StudyError(f"there are no {what}{matching} in {folder}. Check folder and pattern.")
    named_by_folder = pattern is not None and _is_plain_name(pattern)
    by_id = unique_by_id(
        (path.parent.name if named_by_folder else image_stem(path), path) for path in files
    )
    return Cohort(
        folder.name,
        tuple(
            CaseSource(
                case_id,
                (path,),
                partial(read_mask, path, tuple(labels), case_id, organ, allow_truncated),
            )
            for case_id, path in choose(by_id, cases, limit).items()
        ),
    )


def _is_plain_name(pattern: str) -> bool:
    path = PurePosixPath(pattern)
    return len(path.parts) > 1 and not any(sign in path.name for sign in "*?[")

"""A file of a patient who is not in the study, read as the study reads its own cases."""

from __future__ import annotations

from pathlib import Path

from data_prep.image_files import SUFFIXES as IMAGE_SUFFIXES
from data_prep.image_files import image_stem, image_suffix
from data_prep.segments import is_segmentation
from data_prep.surface_files import SUFFIXES as SURFACE_SUFFIXES
from ssm_pipeline.records import CaseError, Mask, StudyError, Surface
from ssm_pipeline.study.sources import DataSettings, Luna16Data, MaskFolderData, MeshFolderData


def read_patient(
    path: Path, data: DataSettings, labels: tuple[int, ...] = (), mirror: bool = False
) -> Mask | Surface:
    """A mask with the study's labels or segments selected, or a surface as it is, in millimetres.

    labels  in place of the study's own: another program's numbers, or the other side.
    mirror  reflected left to right, as a study with data.mirror does with one of the sides.
    Raises  CaseError for a file that can't be read or lacks the organ; StudyError where the study
            does not say which labels a mask should have.
    """
    patient = _read(path, data, labels)
    if mirror:
        from data_prep.sides import reflect

        return reflect(patient)
    return patient


def labels_of(data: DataSettings) -> tuple[int, ...]:
    """The labels that a study's cases have in their masks. Raises StudyError where it has none, or
    two organs in one mask."""
    if isinstance(data, Luna16Data) and data.side != "both":
        from data_prep import luna16

        return (luna16.LEFT if data.side == "left" else luna16.RIGHT,)
    if isinstance(data, MaskFolderData):
        return data.labels
    raise StudyError(
        f"the study is on {data.in_words}, which does not say which label of a mask is the organ. "
        "Pass --label, as --label 3."
    )


def _read(path: Path, data: DataSettings, labels: tuple[int, ...]) -> Mask | Surface:
    if path.suffix.lower() in SURFACE_SUFFIXES:
        from data_prep.surface_folder import read_surface

        if isinstance(data, MeshFolderData):
            return read_surface(path, path.stem, data.unit, data.space)
        return read_surface(path, path.stem)
    masks = data if isinstance(data, MaskFolderData) else None
    threshold = masks.threshold if masks else None
    if masks and masks.segments and not labels and is_segmentation(path):
        from data_prep.segments import read_segments

        stem = image_stem(path)
        return read_segments(path, masks.segments, stem, threshold=threshold)
    if image_suffix(path) is None:
        raise CaseError(
            path.name,
            f"this is neither a label image ({', '.join(IMAGE_SUFFIXES)}) nor a surface "
            f"({', '.join(SURFACE_SUFFIXES)}). Convert it to one of these.",
        )
    from data_prep.images import read_mask

    organ = masks.organ if masks else "organ"
    chosen = labels or labels_of(data)
    return read_mask(path, chosen, image_stem(path), organ, threshold=threshold)

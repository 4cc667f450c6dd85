"""Read the file of a new patient in the same way as the study's own cases."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ssm_pipeline.data_prep.formats.image_files import SUFFIXES as IMAGE_SUFFIXES
from ssm_pipeline.data_prep.formats.image_files import image_stem, image_suffix
from ssm_pipeline.data_prep.formats.organ_size import UnlikelySize
from ssm_pipeline.data_prep.formats.segments import is_segmentation
from ssm_pipeline.data_prep.formats.surface_files import SUFFIXES as SURFACE_SUFFIXES
from ssm_pipeline.data_prep.formats.surface_files import SURFACE_FORMATS, is_surface
from ssm_pipeline.records import CaseError, Mask, StudyError, Surface
from ssm_pipeline.study.sources import (
    DataSettings,
    Luna16Data,
    MaskFolderData,
    MeshFolderData,
    Unit,
)


@dataclass(frozen=True)
class HowToRead:
    """How a patient's file differs from the study's own files.

    Attributes:
        labels: The organ's labels, if another program or the other side has other numbers.
        segments: The organ's names in a .seg.nrrd or DICOM SEG.
        unit: The unit of the file's lengths.
        mirror: Whether to reflect it left to right, as data.mirror does with one of the sides.
    """

    labels: tuple[int, ...] = ()
    segments: tuple[str, ...] = ()
    unit: Unit | None = None
    mirror: bool = False


AS_THE_STUDY = HowToRead()


def read_patient(
    path: Path, data: DataSettings, how: HowToRead = AS_THE_STUDY, case_id: str | None = None
) -> Mask | Surface:
    """A mask with the study's labels or segments selected, or a surface as it is, in millimetres.

    Args:
        case_id: Of the patient. None: the name of the file.

    Raises:
        CaseError: For a file that can't be read or lacks the organ.
        StudyError: If the study does not state which labels a mask has.
    """
    if case_id is None:
        is_surface = path.suffix.lower() in SURFACE_SUFFIXES
        case_id = path.stem if is_surface else image_stem(path)
    try:
        patient = _read(path, data, how, case_id)
    except UnlikelySize as error:  # the study's setting is for its own files
        raise UnlikelySize(case_id, error.found, error.unit, "Pass --unit") from None
    if how.mirror:
        from ssm_pipeline.data_prep.cohorts.sides import reflect

        return reflect(patient)
    return patient


def labels_of(data: DataSettings) -> tuple[int, ...]:
    """The labels that a study's cases have in their masks.

    Raises:
        StudyError: If the study has no labels, or two organs in one mask.
    """
    if isinstance(data, Luna16Data) and data.side != "both":
        from ssm_pipeline.data_prep.cohorts import luna16

        return (luna16.LEFT if data.side == "left" else luna16.RIGHT,)
    if isinstance(data, MaskFolderData):
        return data.labels
    raise StudyError(
        f"the study uses {data.in_words}, so it does not state which label of a mask is the organ. "
        "Pass --label, as in --label 3."
    )


def _read(path: Path, data: DataSettings, how: HowToRead, case_id: str) -> Mask | Surface:
    if path.suffix.lower() in SURFACE_SUFFIXES or is_surface(path):
        from ssm_pipeline.data_prep.cohorts.surface_folder import read_surface

        meshes = data if isinstance(data, MeshFolderData) else None
        unit, space = (meshes.unit, meshes.space) if meshes else (None, None)
        return read_surface(path, case_id, how.unit or unit, space)
    masks = data if isinstance(data, MaskFolderData) else None
    unit = how.unit or (masks.unit if masks else None)
    threshold = masks.threshold if masks and not how.labels else None
    own = masks.segments if masks and not how.labels else ()
    if (segments := how.segments or own) and is_segmentation(path):
        from ssm_pipeline.data_prep.formats.segments import read_segments

        return read_segments(path, segments, case_id, threshold=threshold, unit=unit)
    if how.segments:
        raise CaseError(
            case_id,
            "this file has no named segments; only .seg.nrrd and DICOM SEG have. Pass --label.",
        )
    if image_suffix(path) is None:
        if path.is_file() and is_segmentation(path):
            raise CaseError(case_id, "this is a DICOM SEG. Name its segment: --segment NAME.")
        raise CaseError(
            case_id,
            f"this is neither a label image ({', '.join(IMAGE_SUFFIXES)}) nor a surface "
            f"({SURFACE_FORMATS}). Convert it to one of these.",
        )
    if own and threshold is None:
        raise StudyError(
            f"the study uses the segments {', '.join(own)}, but {path.name} has no named segments. "
            "Pass --label with the organ's label, as in --label 3."
        )
    from ssm_pipeline.data_prep.formats.images import read_organ

    organ = masks.organ if masks else "organ"
    chosen = how.labels or labels_of(data)
    return read_organ(path, chosen, case_id, organ, threshold=threshold, unit=unit)

"""A folder of label images of any organ: one file a case, or one folder a case."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType

from data_prep.case_names import case_name, patient_of
from data_prep.image_files import image_stem, is_image
from data_prep.images import read_mask
from data_prep.segments import is_segmentation, read_segments
from data_prep.selection import choose, cohort_of, files_below, unique_by_id
from data_prep.sides import Side, mirror_side
from ssm_pipeline.records import CaseSource, Cohort, StudyError

_NOTHING: Mapping[str, str] = MappingProxyType({})


def find_cases(
    folder: Path,
    labels: tuple[int, ...] = (1,),
    pattern: str | None = None,
    organ: str = "organ",
    cases: tuple[str, ...] | None = None,
    limit: int | None = None,
    allow_truncated: bool = True,
    segments: tuple[str, ...] = (),
    threshold: float | None = None,
    mirror: Side | None = None,
    exclude: Mapping[str, str] = _NOTHING,
) -> Cohort:
    """The label images of a folder; nothing is read before a case is loaded.

    labels    united to one organ: (1, 2) is a hippocampus of anterior and posterior part.
    pattern   a glob below `folder`; None: every label image directly in it, or, of segmentations
              with named segments, the one in each of its folders. `case_name` tells the ids.
    segments  names, united, in place of labels: 3D Slicer's .seg.nrrd, and DICOM SEG.
    threshold in place of labels: the voxels above it, of a probability map.
    mirror    the side that is reflected, so that left and right are one cohort.
    exclude   case id → why it is left out.
    Raises    StudyError if nothing matches, two files share one id, or a named case is missing.
    """
    if 0 in labels:
        raise StudyError("label 0 is the background, and no organ. Name the organ's own label.")
    if segments:
        named_by_folder = pattern is None and not _any_segmentation(folder)
        pattern = "*/**/*" if named_by_folder else pattern
        files = files_below(folder, pattern, is_segmentation, "segmentations (.seg.nrrd, DICOM)")
    else:
        named_by_folder = False
        what = "label images (.nii.gz, .nii, .nrrd, .mhd, .mha)"
        files = files_below(folder, pattern, is_image, what)
    by_id = unique_by_id(
        (
            path.relative_to(folder).parts[0]
            if named_by_folder
            else case_name(path, image_stem(path), pattern, mirror is not None),
            path,
        )
        for path in files
    )
    sources = [
        CaseSource(
            case_id,
            (path,),
            partial(read_segments, path, segments, case_id, allow_truncated, threshold)
            if segments
            else partial(
                read_mask, path, tuple(labels), case_id, organ, allow_truncated, threshold
            ),
            patient_of(case_id),
        )
        for case_id, path in choose(by_id, cases, limit).items()
    ]
    return cohort_of(folder.name, mirror_side(sources, mirror) if mirror else sources, exclude)


def _any_segmentation(folder: Path) -> bool:
    return folder.is_dir() and any(is_segmentation(path) for path in folder.iterdir())

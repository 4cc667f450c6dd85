"""A folder of label images of any organ: one file per case, or one folder per case."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ssm_pipeline.data_prep.cohorts.case_names import case_name, patient_of, told_apart
from ssm_pipeline.data_prep.cohorts.selection import (
    ALL,
    Choice,
    choose,
    cohort_of,
    files_below,
    unique_by_id,
)
from ssm_pipeline.data_prep.cohorts.sides import mirror_side
from ssm_pipeline.data_prep.formats.image_files import image_stem, is_image
from ssm_pipeline.data_prep.formats.images import read_organ
from ssm_pipeline.data_prep.formats.organ_size import Unit
from ssm_pipeline.data_prep.formats.segments import is_segmentation, read_segments
from ssm_pipeline.records import CaseSource, Cohort, Mask, StudyError


@dataclass(frozen=True)
class Organ:
    """What of an image is the organ.

    Attributes:
        labels: United: (1, 2) is a hippocampus of anterior and posterior part.
        segments: Names, united, in place of labels: 3D Slicer's .seg.nrrd, and DICOM SEG.
        threshold: In place of labels: the voxels above it, of a probability map.
        name: In messages.
        allow_truncated: Whether one that touches the image border is kept, with a warning.
        unit: Of the files' lengths. None: as stated, else mm if the size fits.
    """

    labels: tuple[int, ...] = (1,)
    segments: tuple[str, ...] = ()
    threshold: float | None = None
    name: str = "organ"
    allow_truncated: bool = True
    unit: Unit | None = None

    def read(self, path: Path, case_id: str) -> Mask:
        """Raises CaseError for a file that can't be read or lacks the organ."""
        if self.segments:
            return read_segments(
                path, self.segments, case_id, self.allow_truncated, self.threshold, self.unit
            )
        return read_organ(
            path,
            self.labels,
            case_id,
            self.name,
            self.allow_truncated,
            self.threshold,
            self.unit,
        )


LABEL_ONE = Organ()


def find_cases(
    folder: Path, organ: Organ = LABEL_ONE, pattern: str | None = None, choice: Choice = ALL
) -> Cohort:
    """The label images of a folder; nothing is read before a case is loaded.

    Args:
        pattern: A glob below `folder`; None: every label image directly in it, or, of segmentations
            with named segments, the one in each of its folders. `case_name` tells the ids.

    Raises:
        StudyError: If nothing matches, two files share one id, or a named case is missing.
    """
    if 0 in organ.labels:
        raise StudyError("label 0 is the background, and no organ. Name the organ's own label.")
    if organ.segments:
        named_by_folder = pattern is None and not _any_segmentation(folder)
        pattern = "*/**/*" if named_by_folder else pattern
        files = files_below(folder, pattern, is_segmentation, "segmentations (.seg.nrrd, DICOM)")
    else:
        named_by_folder = False
        what = "label images (.nii.gz, .nii, .nrrd, .mhd, .mha)"
        files = files_below(folder, pattern, is_image, what)
    below = [path.relative_to(folder) for path in files]
    if named_by_folder:
        names = [path.parts[0] for path in below]
    else:
        with_sides = choice.mirror is not None
        names = [case_name(path, image_stem(path), pattern, with_sides) for path in files]
        names = told_apart(names, below)
    by_id = unique_by_id(zip(names, files, strict=True))
    sources = [
        CaseSource(
            case_id,
            (path,),
            partial(organ.read, path, case_id),
            patient_of(case_id),
        )
        for case_id, path in choose(by_id, choice).items()
    ]
    return cohort_of(folder.name, mirror_side(sources, choice.mirror), choice)


def _any_segmentation(folder: Path) -> bool:
    return folder.is_dir() and any(is_segmentation(path) for path in folder.iterdir())

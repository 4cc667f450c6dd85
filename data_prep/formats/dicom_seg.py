"""DICOM SEG: segments by their label. Needs the extra `dicom` (highdicom, pydicom)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ssm_pipeline.data_prep.formats.label_images import LabelImage, place
from ssm_pipeline.records import CaseError, StudyError

MOST_SLICES = 10_000  # two metres at 0.2 mm: between frames that lie farther apart, nothing is


def is_dicom_seg(path: Path) -> bool:
    """True for a DICOM file whose modality is SEG; its header alone is read.

    Raises:
        StudyError: Where pydicom is not installed.
    """
    with path.open("rb") as file:
        if file.read(132)[128:] != b"DICM":
            return False
    try:
        import pydicom
    except ImportError as error:
        raise StudyError(
            f"{path} is a DICOM file; reading them needs highdicom and pydicom. "
            'Install them: pip install "ssm-pipeline[dicom]".'
        ) from error
    try:
        header = pydicom.dcmread(path, stop_before_pixels=True, specific_tags=["Modality"])
        return str(header.get("Modality", "")) == "SEG"
    except Exception:  # pydicom raises whatever the damage happens to break
        return False


def read_dicom_segments(path: Path, case_id: str) -> list[tuple[str, LabelImage, int]]:
    """Of every segment its label, an image, and the value that it has in it.

    Frames without a voxel of any segment are mostly left out of such files; an empty slice is put
    at both ends, so whether the organ was cut off there can't be known.

    Raises:
        CaseError: For a file that is damaged or no regular grid.
    """
    import highdicom

    try:
        segmentation = highdicom.seg.segread(path)
        labels = [
            str(segmentation.get_segment_description(number).segment_label)
            for number in segmentation.segment_numbers
        ]
        geometry = segmentation.get_volume_geometry()
        if geometry is not None and geometry.spatial_shape[0] > MOST_SLICES:
            raise ValueError(f"its frames span {geometry.spatial_shape[0]} slices")
        volume = segmentation.get_volume(skip_overlap_checks=True)
    except Exception as error:  # pydicom and highdicom raise whatever the damage happens to break
        what = str(error) or type(error).__name__
        raise CaseError(
            case_id,
            f"{path.name} can't be read as DICOM SEG ({what}). A whole file with equally spaced, "
            "parallel slices is needed; export it again.",
        ) from error
    # Index (slice, row, column) → x, y, z; then one empty slice before the first.
    affine = np.asarray(volume.affine)[:, [2, 1, 0, 3]]
    affine[:, 3] -= affine[:, 2]
    array = np.pad(np.asarray(volume.array), ((1, 1), (0, 0), (0, 0), (0, 0)))
    return [
        (label, place(array[..., position], affine, case_id), 1)
        for position, label in enumerate(labels)
    ]

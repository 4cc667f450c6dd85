"""Segments by name: 3D Slicer's `.seg.nrrd` and DICOM SEG."""

from __future__ import annotations

import difflib
from dataclasses import replace
from pathlib import Path

import numpy as np

from ssm_pipeline.data_prep.formats.dicom_seg import is_dicom_seg, read_dicom_segments
from ssm_pipeline.data_prep.formats.image_files import image_suffix, is_image, stated_unit
from ssm_pipeline.data_prep.formats.label_images import LabelImage, scaled
from ssm_pipeline.data_prep.formats.organ_masks import mask_diagonal, organ_mask, select_labels
from ssm_pipeline.data_prep.formats.organ_size import MM_OF, Unit, check_size
from ssm_pipeline.data_prep.formats.slicer_segments import Segments, read_slicer_segments
from ssm_pipeline.records import CaseError, Mask


def is_segmentation(path: Path) -> bool:
    """True for a file that may name its segments: NRRD, or DICOM SEG."""
    if is_image(path):
        return image_suffix(path) in (".seg.nrrd", ".nrrd")
    if path.name.startswith(".") or not path.is_file():
        return False
    named_by_uid = path.suffix[1:].isdigit()  # 1.2.840.7: no suffix at all
    return (path.suffix.lower() in ("", ".dcm") or named_by_uid) and is_dicom_seg(path)


def read_segments(
    path: Path,
    names: tuple[str, ...],
    case_id: str,
    allow_truncated: bool = True,
    threshold: float | None = None,
    unit: Unit | None = None,
) -> Mask:
    """The union of the named segments as a Mask. Upper and lower case count as the same.

    Of several the mask keeps which voxel has which, 1 … in the order of the names; where they
    overlap, the first.

    Args:
        threshold: For fractional DICOM SEG: a voxel above it is organ.
        unit: Of the file's lengths. None: what it states, else mm, if the size could be an organ's.

    Raises:
        CaseError: the file is damaged, names no segments, lacks one of them or has it twice, or
            its organ has a size that no organ has in millimetres.
    """
    if not path.is_file():
        raise CaseError(case_id, f"there is no file {path}. Check the folder and the file name.")
    if image_suffix(path) is None:
        segments = read_dicom_segments(path, case_id)
    else:
        segments = read_slicer_segments(path, case_id)
        threshold = None  # a segment is a label there, never a share
    factor = MM_OF[unit or (stated_unit(path) if image_suffix(path) else None) or "mm"]
    segments = [(name, scaled(image, factor), value) for name, image, value in segments]
    chosen = [_match(name, segments, path, case_id) for name in names]
    _refuse_equal_segments(names, chosen, segments, threshold, path, case_id)
    masks = [
        select_labels(image, (value,), name, threshold=threshold)
        for name, (image, value) in zip(names, chosen, strict=True)
    ]
    whole = _united(names, chosen, masks, allow_truncated)
    if unit is None:
        check_size(mask_diagonal(whole), case_id, f"{' + '.join(names)} in {path.name}")
    return whole


def _united(
    names: tuple[str, ...],
    chosen: list[tuple[LabelImage, int]],
    masks: list[Mask],
    allow_truncated: bool,
) -> Mask:
    if len(masks) == 1:
        return organ_mask(chosen[0][0], masks[0].voxels, names[0], allow_truncated)
    parts = np.zeros(masks[0].voxels.shape, np.int32)
    for number, mask in reversed(list(enumerate(masks, start=1))):
        parts[mask.voxels] = number
    whole = organ_mask(chosen[0][0], parts > 0, " + ".join(names), allow_truncated)
    return replace(whole, labels=parts)


def _refuse_equal_segments(
    names: tuple[str, ...],
    chosen: list[tuple[LabelImage, int]],
    segments: Segments,
    threshold: float | None,
    path: Path,
    case_id: str,
) -> None:
    """Raise CaseError if a chosen segment has exactly the voxels of another one."""

    def voxels_of(image: LabelImage, value: int) -> np.ndarray:
        return image.labels == value if threshold is None else image.labels > threshold

    for name, (image, value) in zip(names, chosen, strict=True):
        voxels = voxels_of(image, value)
        for other, other_image, other_value in segments:
            if other_image is image and other_value == value:
                continue
            if voxels.any() and np.array_equal(voxels, voxels_of(other_image, other_value)):
                raise CaseError(
                    case_id,
                    f"{path.name}: the segments {name} and {other} have the same voxels, so that "
                    "one of them is wrong or a copy. Correct it, or delete one of them.",
                )


def _match(name: str, segments: Segments, path: Path, case_id: str) -> tuple[LabelImage, int]:
    """The one segment of that name, in upper or lower case if none has it exactly so."""
    exact = [segment for segment in segments if segment[0] == name]
    found = exact or [s for s in segments if s[0].casefold() == name.casefold()]
    if len(found) == 1:
        return found[0][1:]
    if found:
        raise CaseError(
            case_id,
            f"{path.name} has {len(found)} segments named {name}, and which is meant can't be "
            "known. Give each a name of its own, and ask for one of them, or for several.",
        )
    known = sorted({segment[0] for segment in segments})
    near = difflib.get_close_matches(name, known, n=1)
    hint = f" Did you mean {near[0]}?" if near else ""
    raise CaseError(case_id, f"{path.name} has no segment {name}; it has {', '.join(known)}.{hint}")

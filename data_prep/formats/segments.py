"""Segments by name: 3D Slicer's `.seg.nrrd` and DICOM SEG."""

from __future__ import annotations

import difflib
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import SimpleITK as sitk

from ssm_pipeline.data_prep.formats.dicom_seg import is_dicom_seg, read_dicom_segments
from ssm_pipeline.data_prep.formats.image_files import check_voxels, image_suffix, is_image
from ssm_pipeline.data_prep.formats.images import read_image
from ssm_pipeline.data_prep.formats.label_images import LabelImage
from ssm_pipeline.data_prep.formats.organ_masks import organ_mask, select_labels
from ssm_pipeline.records import CaseError, Mask

Segments = list[tuple[str, LabelImage, int]]  # name, an image, and the segment's value in it


def is_segmentation(path: Path) -> bool:
    """True for a file that may name its segments: NRRD, or DICOM SEG."""
    if path.name.startswith(".") or not path.is_file():
        return False
    if is_image(path):
        return image_suffix(path) in (".seg.nrrd", ".nrrd")
    named_by_uid = path.suffix[1:].isdigit()  # 1.2.840.7: no suffix at all
    return (path.suffix.lower() in ("", ".dcm") or named_by_uid) and is_dicom_seg(path)


def read_segments(
    path: Path,
    names: tuple[str, ...],
    case_id: str,
    allow_truncated: bool = True,
    threshold: float | None = None,
) -> Mask:
    """The union of the named segments as a Mask. Upper and lower case count as the same.

    Of several the mask keeps which voxel has which, 1 … in the order of the names; where they
    overlap, the first.

    threshold  for fractional DICOM SEG: a voxel above it is organ.
    Raises     CaseError for a damaged file, one without names, and a segment that is not there or
               there twice.
    """
    if not path.is_file():
        raise CaseError(case_id, f"there is no file {path}. Check the folder and the file name.")
    if image_suffix(path) is None:
        segments = read_dicom_segments(path, case_id)
    else:
        segments = read_slicer_segments(path, case_id)
        threshold = None  # a segment is a label there, never a share
    chosen = [_match(name, segments, path, case_id) for name in names]
    masks = [
        select_labels(image, (value,), name, threshold=threshold)
        for name, (image, value) in zip(names, chosen, strict=True)
    ]
    if len(masks) == 1:
        return organ_mask(chosen[0][0], masks[0].voxels, names[0], allow_truncated)
    parts = np.zeros(masks[0].voxels.shape, np.int32)
    for number, mask in reversed(list(enumerate(masks, start=1))):
        parts[mask.voxels] = number
    whole = organ_mask(chosen[0][0], parts > 0, " + ".join(names), allow_truncated)
    return replace(whole, labels=parts)


def read_slicer_segments(path: Path, case_id: str) -> Segments:
    """The segments of a NRRD file as 3D Slicer writes it: `Segment<i>_Name`, layer and value.

    Raises CaseError for a damaged file, or one that names no segment.
    """
    image = read_image(path, case_id)
    if image.GetDimension() != 3:
        raise CaseError(
            case_id,
            f"{path.name} has {image.GetDimension()} dimensions; a 3D segmentation is needed.",
        )
    array = sitk.GetArrayFromImage(image)
    check_voxels(path, case_id, array)
    if array.ndim == 3:  # one layer: segments that don't overlap
        array = array[..., None]
    segments: Segments = []
    for key in sorted(image.GetMetaDataKeys()):
        if not re.fullmatch("Segment[0-9]+_Name", key):
            continue
        prefix = key.removesuffix("Name")
        layer, value = _number(image, prefix + "Layer", 0), _number(image, prefix + "LabelValue", 1)
        if not 0 <= layer < array.shape[-1]:
            raise CaseError(
                case_id, f"{path.name} puts {key} in layer {layer} of {array.shape[-1]}."
            )
        labels = LabelImage(
            array[..., layer],
            np.array(image.GetSpacing()),
            np.array(image.GetOrigin()),
            np.array(image.GetDirection()).reshape(3, 3),
            case_id,
        )
        name = image.GetMetaData(key).encode(errors="replace").decode()  # may be no UTF-8
        segments.append((name.strip(), labels, value))
    if not segments:
        raise CaseError(
            case_id,
            f"{path.name} names no segments; 3D Slicer's .seg.nrrd does. Select by data.labels, "
            "or save it as a segmentation.",
        )
    return segments


def _number(image: sitk.Image, key: str, least: int) -> int:
    text = image.GetMetaData(key).strip() if image.HasMetaDataKey(key) else ""
    return int(text) if text.isdigit() else least


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

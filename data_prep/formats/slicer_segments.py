"""The named segments of a NRRD file as 3D Slicer writes it (.seg.nrrd)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import SimpleITK as sitk

from ssm_pipeline.data_prep.formats.image_files import check_voxels
from ssm_pipeline.data_prep.formats.images import read_image
from ssm_pipeline.data_prep.formats.label_images import LabelImage
from ssm_pipeline.records import CaseError

Segments = list[tuple[str, LabelImage, int]]  # name, an image, and the segment's value in it


def read_slicer_segments(path: Path, case_id: str) -> Segments:
    """The segments of a NRRD file as 3D Slicer writes it.

    Since version 4.11 each segment has `Segment<i>_Layer` and `_LabelValue`. Before, the file has
    one component per segment, in the order of the numbers, and the value is 1.

    Raises:
        CaseError: the file is damaged, names no segment, or does not say where a segment is.
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
    named = (re.fullmatch("Segment([0-9]+)_Name", key) for key in image.GetMetaDataKeys())
    numbers = sorted(int(found[1]) for found in named if found)
    if not numbers:
        raise CaseError(
            case_id,
            f"{path.name} names no segments; 3D Slicer's .seg.nrrd does. Select by data.labels, "
            "or save it as a segmentation.",
        )
    places = _places(image, array, numbers, path, case_id)
    segments: Segments = []
    for number, (layer, value) in zip(numbers, places, strict=True):
        labels = LabelImage(
            array[..., layer],
            np.array(image.GetSpacing()),
            np.array(image.GetOrigin()),
            np.array(image.GetDirection()).reshape(3, 3),
            case_id,
        )
        name = image.GetMetaData(f"Segment{number}_Name")
        name = name.encode(errors="replace").decode()  # may be no UTF-8
        segments.append((name.strip(), labels, value))
    return segments


def _places(
    image: sitk.Image, array: np.ndarray, numbers: list[int], path: Path, case_id: str
) -> list[tuple[int, int]]:
    """Layer and label value of each segment.

    Raises:
        CaseError: Where the file does not tell.
    """
    layers = array.shape[-1]
    stated = [
        (_number(image, f"Segment{number}_Layer"), _number(image, f"Segment{number}_LabelValue"))
        for number in numbers
    ]
    if all(place == (None, None) for place in stated):
        if layers != len(numbers) or array.max() > 1:
            raise CaseError(
                case_id,
                f"{path.name} names {len(numbers)} segments without layers and label values, and "
                f"has {layers} layers with values up to {array.max()}; one layer of 0 and 1 per "
                "segment is needed. Save it again from 3D Slicer.",
            )
        return [(layer, 1) for layer in range(layers)]
    places: list[tuple[int, int]] = []
    for number, (layer, value) in zip(numbers, stated, strict=True):
        key = f"Segment{number}"
        layer = 0 if layer is None and layers == 1 else layer  # there is no other
        if layer is None or value is None:
            missing = "Layer" if layer is None else "LabelValue"
            raise CaseError(
                case_id,
                f"{path.name} has no {key}_{missing}, and other segments have one, so that the "
                "segment's voxels can't be known. Save it again from 3D Slicer.",
            )
        if not 0 <= layer < layers:
            raise CaseError(case_id, f"{path.name} puts {key} in layer {layer} of {layers}.")
        if (layer, value) in places:
            other = f"Segment{numbers[places.index((layer, value))]}"
            raise CaseError(
                case_id,
                f"{path.name} gives {other} and {key} the same voxels (layer {layer}, value "
                f"{value}), so that one of them is wrong. Save it again from 3D Slicer.",
            )
        places.append((layer, value))
    return places


def _number(image: sitk.Image, key: str) -> int | None:
    """None where the key is missing or its text is no number."""
    text = image.GetMetaData(key).strip() if image.HasMetaDataKey(key) else ""
    return int(text) if text.isdecimal() else None

"""Label image → Mask, in patient space (LPS, mm)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import SimpleITK as sitk

from data_prep.image_files import check_header, check_voxels
from ssm_pipeline.records import CaseError, Mask

MIN_VOXELS = 64  # a 4 × 4 × 4 block: less is no surface


@dataclass(frozen=True, eq=False)
class LabelImage:
    """labels (Z, Y, X), any number type; spacing_mm (3,), origin_mm (3,), direction (3, 3) LPS."""

    labels: np.ndarray
    spacing_mm: np.ndarray
    origin_mm: np.ndarray
    direction: np.ndarray
    case_id: str


def read_labels(path: Path, case_id: str) -> LabelImage:
    """Read `.mhd`, `.mha`, `.nrrd`, `.nii` or `.nii.gz`. SimpleITK gives LPS for all of them.

    Raises CaseError for a file that is missing, damaged, not 3D, or without a usable spacing.
    """
    if not path.is_file():
        raise CaseError(case_id, f"there is no file {path}. Check the folder and the file name.")
    check_header(path, case_id)
    try:
        image = sitk.ReadImage(str(path))
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1].strip()
        raise CaseError(
            case_id,
            f"{path.name} can't be read ({reason}). Check that the file is whole and that it is "
            "a label image.",
        ) from error
    size = " × ".join(str(length) for length in image.GetSize())
    if image.GetDimension() != 3 or image.GetNumberOfComponentsPerPixel() != 1:
        raise CaseError(
            case_id,
            f"{path.name} holds a {size} image with {image.GetNumberOfComponentsPerPixel()} "
            "value(s) per voxel; one 3D volume of labels is needed. Export it as such.",
        )
    labels = sitk.GetArrayFromImage(image)
    check_voxels(path, case_id, labels)
    return LabelImage(
        labels=labels,
        spacing_mm=np.array(image.GetSpacing()),
        origin_mm=np.array(image.GetOrigin()),
        direction=np.array(image.GetDirection()).reshape(3, 3),
        case_id=case_id,
    )


def select_labels(
    image: LabelImage, labels: tuple[int, ...], organ: str = "organ", allow_truncated: bool = True
) -> Mask:
    """The union of `labels` as a Mask; `organ` names it in messages.

    An organ on the image border is cut off: a warning on the Mask, or, without
    `allow_truncated`, a CaseError. Raises CaseError if a label is absent or the organ is too small.
    """
    if not labels:
        raise CaseError(image.case_id, f"no label was given for the {organ}; name at least one.")
    voxels = image.labels == labels[0]
    for label in labels[1:]:
        voxels |= image.labels == label
    count = int(np.count_nonzero(voxels))
    named = f"{organ} (label {', '.join(map(str, labels))})"
    if count == 0:
        found = np.unique(image.labels)
        found = found[found != 0]
        listed = ", ".join(f"{value:g}" for value in found[:20]) or "none: the mask is empty"
        raise CaseError(
            image.case_id,
            f"the {named} is absent; labels found: {listed}. Check the label numbers.",
        )
    if count < MIN_VOXELS:
        raise CaseError(
            image.case_id,
            f"the {named} holds {count} voxel(s); at least {MIN_VOXELS} are needed for a surface. "
            "Check the segmentation.",
        )
    truncation = border_contact(voxels)
    if truncation and not allow_truncated:
        raise CaseError(
            image.case_id,
            f"the {named} touches the image border on {truncation}; the organ is cut off. "
            "Leave such cases out, or set allow_truncated.",
        )
    warnings = (
        (f"the {named} touches the image border on {truncation}: it may be cut off",)
        if truncation
        else ()
    )
    return Mask(voxels, image.spacing_mm, image.origin_mm, image.direction, image.case_id, warnings)


def read_mask(
    path: Path,
    labels: tuple[int, ...],
    case_id: str,
    organ: str = "organ",
    allow_truncated: bool = True,
) -> Mask:
    """Read one file and select its organ; raises as `read_labels` and `select_labels` do."""
    return select_labels(read_labels(path, case_id), labels, organ, allow_truncated)


def border_contact(voxels: np.ndarray) -> str:
    """Which outer slices of the image (Z, Y, X) the organ reaches, in words; '' if none."""
    touched = []
    for axis, name in ((0, "z"), (1, "y"), (2, "x")):
        for end, index in (("first", 0), ("last", -1)):
            count = int(np.count_nonzero(voxels.take(index, axis=axis)))
            if count:
                touched.append(f"{end} {name}: {count} voxels")
    if not touched:
        return ""
    return f"{len(touched)} border slice{'s' * (len(touched) > 1)} ({', '.join(touched)})"

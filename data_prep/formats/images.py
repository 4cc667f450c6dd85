"""Label image → Mask, in patient space (LPS, mm)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import SimpleITK as sitk

from ssm_pipeline.data_prep.formats.image_files import check_header, check_voxels
from ssm_pipeline.data_prep.formats.image_memory import refuse_too_large
from ssm_pipeline.records import CaseError, Mask

MIN_VOXELS = 64  # a 4 × 4 × 4 block: less is no surface
FEWEST_SOFT_VALUES = 10  # of fewer, even thin shells may be parts of an organ
SLICES_LOOKED_AT = 50


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
    header = check_header(path, case_id)
    image = read_image(path, case_id)
    size = " × ".join(str(length) for length in image.GetSize())
    if image.GetDimension() != 3 or image.GetNumberOfComponentsPerPixel() != 1:
        raise CaseError(
            case_id,
            f"{path.name} holds a {size} image with {image.GetNumberOfComponentsPerPixel()} "
            "value(s) per voxel; one 3D volume of labels is needed. Export it as such.",
        )
    labels = sitk.GetArrayFromImage(image)
    check_voxels(path, case_id, labels)
    if header is not None and header.misleads_itk:
        return place(labels, header.affine_lps(), case_id)
    return LabelImage(
        labels=labels,
        spacing_mm=np.array(image.GetSpacing()),
        origin_mm=np.array(image.GetOrigin()),
        direction=np.array(image.GetDirection()).reshape(3, 3),
        case_id=case_id,
    )


def read_image(path: Path, case_id: str) -> sitk.Image:
    """SimpleITK's image. Raises CaseError where SimpleITK can't read the file, StudyError where
    there is not the memory for it."""
    try:
        refuse_too_large(path, case_id)
        return sitk.ReadImage(str(path))
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1].strip()
        raise CaseError(
            case_id,
            f"{path.name} can't be read ({reason}). Check that the file is whole and that it is "
            "a label image.",
        ) from error


def place(labels: np.ndarray, affine: np.ndarray, case_id: str) -> LabelImage:
    """Labels (Z, Y, X) where a (4, 4) matrix, voxel index x, y, z → mm LPS, puts them.

    Raises CaseError where its axes are not at right angles.
    """
    spacing = np.linalg.norm(affine[:3, :3], axis=0)
    direction = affine[:3, :3] / np.maximum(spacing, 1e-12)
    skew = np.abs(direction.T @ direction - np.eye(3)).max()
    if not (np.isfinite(affine).all() and skew < 1e-3):  # float32 headers: 1e-6
        raise CaseError(
            case_id,
            "the image's axes are not at right angles or not finite; a plain grid is needed. "
            "Resample it to one, or export it again.",
        )
    return LabelImage(labels, spacing, affine[:3, 3], direction, case_id)


def select_labels(
    image: LabelImage,
    labels: tuple[int, ...],
    organ: str = "organ",
    allow_truncated: bool = True,
    threshold: float | None = None,
) -> Mask:
    """The union of `labels` as a Mask, or the voxels above `threshold`; `organ` names it.

    Of several labels the mask keeps which voxel has which.
    Raises CaseError if a label is absent, the organ is too small, or the image holds values
    between whole numbers and no threshold is given; and as `organ_mask` does.
    """
    if threshold is not None:
        named = f"{organ} (above {threshold:g})"
        voxels = image.labels > threshold
        if not voxels.any():
            raise CaseError(
                image.case_id,
                f"no voxel of the {organ} lies above data.threshold = {threshold:g}; the largest "
                f"value is {image.labels.max():g}. Lower the threshold.",
            )
        return organ_mask(image, voxels, named, allow_truncated)
    if not labels:
        raise CaseError(image.case_id, f"no label was given for the {organ}; name at least one.")
    _refuse_soft_values(image)
    named = f"{organ} (label {', '.join(map(str, labels))})"
    found = np.unique(image.labels)
    absent = [label for label in labels if label not in found]
    if absent:
        found = found[found != 0]
        listed = ", ".join(f"{value:g}" for value in found[:20]) or "none: the mask is empty"
        what = named if len(absent) == len(labels) else f"{organ}'s label {absent[0]}"
        raise CaseError(
            image.case_id,
            f"the {what} is absent; labels found: {listed}. Check the label numbers.",
        )
    voxels = np.isin(image.labels, labels)
    mask = organ_mask(image, voxels, named, allow_truncated)
    if len(set(labels)) == 1:
        return mask
    return replace(mask, labels=np.where(voxels, image.labels, 0).astype(np.int32))


def organ_mask(
    image: LabelImage, voxels: np.ndarray, named: str, allow_truncated: bool = True
) -> Mask:
    """Voxels (Z, Y, X) bool of one organ, `named` in messages, as a Mask.

    An organ on the image border is cut off: a warning on the Mask, or, without
    `allow_truncated`, a CaseError. Raises CaseError if the organ is too small.
    """
    count = int(np.count_nonzero(voxels))
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


def _refuse_soft_values(image: LabelImage) -> None:
    """Raise CaseError for a probability map, of 0 … 1 or of whole numbers such as 0 … 255, and for
    a scan: one of its values as a label would be a thin shell, or its certain voxels alone."""
    if np.issubdtype(image.labels.dtype, np.floating):
        soft = image.labels[image.labels != np.rint(image.labels)]
        if len(soft):
            raise CaseError(
                image.case_id,
                f"{len(soft)} voxels hold values between whole numbers (such as {soft[0]:.3g}), as "
                "probability maps do; labels are whole numbers. Say from which value on a voxel is "
                "organ (data.threshold, such as 0.5), or export a label image.",
            )
    values = soft_values(image.labels)
    if len(values):
        raise CaseError(
            image.case_id,
            f"neighbouring voxels mostly differ ({len(values)} values, {values[0]:g} … "
            f"{values[-1]:g}), as in probability maps and scans; voxels of one label lie together. "
            f"Of a probability map, say from which value on a voxel is organ (data.threshold, such "
            f"as {values[-1] / 2:g}); else give a label image.",
        )


def soft_values(labels: np.ndarray) -> np.ndarray:
    """The values of an image (Z, Y, X) that is no label image, though its numbers are whole; none
    for a label image.

    There are many, and voxels beside each other mostly differ, but for the background and the
    most certain value. In label images, they differ at borders alone.
    """
    few = labels[:: max(1, len(labels) // SLICES_LOOKED_AT)]
    top = few.max()
    if float(top) - float(few.min()) < FEWEST_SOFT_VALUES:  # most label images are done here
        return np.empty(0)
    one, other = few[..., :-1], few[..., 1:]
    within = (one != 0) & (other != 0) & ((one != top) | (other != top))
    differ = (one != other) & within
    if 2 * np.count_nonzero(differ) <= np.count_nonzero(within):
        return np.empty(0)
    values = np.unique(few[few != 0])
    return values if len(values) >= FEWEST_SOFT_VALUES else np.empty(0)


def read_mask(
    path: Path,
    labels: tuple[int, ...],
    case_id: str,
    organ: str = "organ",
    allow_truncated: bool = True,
    threshold: float | None = None,
) -> Mask:
    """Read one file and select its organ; raises as `read_labels` and `select_labels` do."""
    return select_labels(read_labels(path, case_id), labels, organ, allow_truncated, threshold)


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

"""Label image → Mask of one organ: its labels, or the voxels above a threshold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ssm_pipeline.data_prep.formats.label_images import LabelImage
from ssm_pipeline.records import CaseError, Mask

MIN_VOXELS = 64  # a 4 × 4 × 4 block: less is no surface
FEWEST_SOFT_VALUES = 10  # of fewer, even thin shells may be parts of an organ
SLICES_LOOKED_AT = 50
NEARLY_WHOLE = 1e-3  # labels that a program scaled or resampled: 1.00003


def select_labels(
    image: LabelImage,
    labels: tuple[int, ...],
    organ: str = "organ",
    allow_truncated: bool = True,
    threshold: float | None = None,
) -> Mask:
    """The union of `labels` as a Mask, or the voxels above `threshold`; `organ` names it.

    Of several labels the mask keeps which voxel has which.

    Raises:
        CaseError: If a label is absent, the organ is too small, or the image holds values between
            whole numbers and no threshold is given; and as `organ_mask` does.
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
    image = _rounded(image)
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

    An organ on the image border is cut off: a warning on the Mask, or, without `allow_truncated`, a
    CaseError.

    Raises:
        CaseError: If the organ is too small.
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
    warnings = image.warnings
    if truncation:
        warnings += (f"the {named} touches the image border on {truncation}: it may be cut off",)
    return Mask(voxels, image.spacing_mm, image.origin_mm, image.direction, image.case_id, warnings)


def _rounded(image: LabelImage) -> LabelImage:
    """Labels that are whole but for what scaling or resampling added, made whole."""
    if not np.issubdtype(image.labels.dtype, np.floating):
        return image
    whole = np.rint(image.labels)
    off = np.abs(image.labels - whole)
    count = int(np.count_nonzero(off))
    if not count or not off.max() <= NEARLY_WHOLE:  # a comparison with NaN is false
        return image
    example = image.labels.ravel()[off.argmax()]
    remark = f"{count} voxels hold labels such as {example:.8g}; they were rounded"
    return replace(image, labels=whole, warnings=(*image.warnings, remark))


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


def mask_diagonal(mask: Mask) -> float:
    """Of the box of voxels around the organ, in mm."""
    lengths = []
    for axis in range(3):
        others = tuple(other for other in range(3) if other != axis)
        used = np.flatnonzero(mask.voxels.any(axis=others))
        lengths.append(used[-1] - used[0] + 1)
    return float(np.linalg.norm(np.array(lengths)[::-1] * mask.spacing_mm))

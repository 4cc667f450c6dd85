"""A label image in patient space, and where a matrix puts its voxels."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ssm_pipeline.records import CaseError

MOST_SKEW = 1e-3  # cosine between two axes: 0.06 degrees; float32 headers give 1e-6


@dataclass(frozen=True, eq=False)
class LabelImage:
    """labels (Z, Y, X), any number type; spacing_mm (3,), origin_mm (3,), direction (3, 3) LPS."""

    labels: np.ndarray
    spacing_mm: np.ndarray
    origin_mm: np.ndarray
    direction: np.ndarray
    case_id: str
    warnings: tuple[str, ...] = ()


def place(
    labels: np.ndarray, affine: np.ndarray, case_id: str, warnings: tuple[str, ...] = ()
) -> LabelImage:
    """Labels (Z, Y, X) where a (4, 4) matrix, voxel index x, y, z → mm LPS, puts them.

    Axes that are skewed by less than a thousandth are made perpendicular.

    Raises:
        CaseError: the axes are not at right angles.
    """
    spacing = np.linalg.norm(affine[:3, :3], axis=0)
    direction = affine[:3, :3] / np.maximum(spacing, 1e-12)
    skew = np.abs(direction.T @ direction - np.eye(3)).max()
    if not (np.isfinite(affine).all() and skew < MOST_SKEW):
        found = f"{math.degrees(math.asin(min(skew, 1.0))):.2g} degrees" if skew == skew else "nan"
        raise CaseError(
            case_id,
            f"the image's axes are not at right angles (off by {found}) or not finite; a plain "
            "grid is needed. Resample it to one, or export it again.",
        )
    return LabelImage(labels, spacing, affine[:3, 3], direction, case_id, warnings)


def scaled(image: LabelImage, factor: float) -> LabelImage:
    """The image with all lengths multiplied by a factor."""
    if factor == 1:
        return image
    return replace(image, spacing_mm=factor * image.spacing_mm, origin_mm=factor * image.origin_mm)

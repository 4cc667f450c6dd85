"""Mask → smooth field on an isotropic grid, whose level set keeps the mask's volume."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.special import erf

from ssm_pipeline.records import CaseError, Mask

LEAST_SIGMA = 0.6  # voxels
THIN_SIGMA = 0.4  # voxels: the centre of a line of single voxels keeps 60 %
NEAR = 0.02  # of a blurred thin part: above it, the field is the sharp one
_MAX_POINTS = 3e8  # 1.2 GB of float32


@dataclass(frozen=True, eq=False)
class SmoothField:
    """values (Z, Y, X) float32 in [0, 1]: the share of organ under the Gaussian at each point.

    Attributes:
        voxel_mm: Isotropic distance of the grid points.
        origin_mm: (3,) LPS of values[0, 0, 0]; direction (3, 3), columns are the axes x, y, z.
        level: {values > level} has the organ's volume.
    """

    values: np.ndarray
    voxel_mm: float
    origin_mm: np.ndarray
    direction: np.ndarray
    level: float


def smooth_field(
    organ: Mask, voxel_mm: float, smoothing_mm: float, thin: np.ndarray | None = None
) -> SmoothField:
    """Blur the organ with a Gaussian and sample it on an isotropic grid.

    The mask is piecewise constant over its voxels, and the Gaussian is integrated over each of
    them: thick slices keep their thickness. Sigma is at least 0.6 voxels along each axis: less
    leaves the slices visible as steps. The grid reaches at least 4 sigma beyond the organ.

    Args:
        organ: The mask, cropped to the organ.
        voxel_mm: Distance of the grid points.
        smoothing_mm: Sigma of the Gaussian.
        thin: (Z, Y, X) bool, voxels of thin parts. Near them sigma is 0.4 voxels.

    Raises:
        CaseError: The grid is too large for memory, or too coarse for the organ.
    """
    sigmas = np.maximum(smoothing_mm, LEAST_SIGMA * organ.spacing_mm)  # x, y, z
    margins = np.maximum(4 * smoothing_mm + 2 * voxel_mm, 4 * sigmas)
    extent_mm = np.array(organ.voxels.shape[::-1]) * organ.spacing_mm
    points = np.prod((extent_mm + 2 * margins) / voxel_mm + 1)
    if points > _MAX_POINTS:
        raise CaseError(
            organ.case_id,
            f"a grid of {voxel_mm:g} mm over an organ of {np.round(extent_mm)} mm has {points:.1e} "
            f"points; at most {_MAX_POINTS:.0e} are accepted. Raise meshing.voxel_mm, or set "
            "data.unit if the organ's size is wrong.",
        )
    extents = (np.array(organ.voxels.shape[::-1]) - 1) * organ.spacing_mm
    counts = np.ceil((extents + 2 * margins) / voxel_mm).astype(int) + 1
    starts = (extents - (counts - 1) * voxel_mm) / 2
    targets = [start + voxel_mm * np.arange(n) for start, n in zip(starts, counts, strict=True)]
    values = _blurred(organ.voxels, organ.spacing_mm, sigmas, targets)
    if thin is not None:
        sharp = _blurred(organ.voxels, organ.spacing_mm, THIN_SIGMA * organ.spacing_mm, targets)
        reach = np.maximum(sigmas, 2 * organ.spacing_mm)
        nearness = _blurred(thin, organ.spacing_mm, reach, targets)
        values += np.minimum(nearness / NEAR, 1) * (sharp - values)
    return SmoothField(
        values=values,
        voxel_mm=voxel_mm,
        origin_mm=organ.origin_mm + organ.direction @ starts,
        direction=organ.direction,
        level=volume_level(values, organ, voxel_mm),
    )


def _blurred(
    voxels: np.ndarray, spacing_mm: np.ndarray, sigmas: np.ndarray, targets: list[np.ndarray]
) -> np.ndarray:
    """Voxels (Z, Y, X) under a Gaussian, at the grid of `targets` (mm from the first voxel).

    spacing_mm, sigmas (mm) and targets are in the order x, y, z.
    """
    values = voxels
    # The axis that shrinks most first: every later product is then smaller.
    for axis in np.argsort(spacing_mm):
        spacing, sigma = float(spacing_mm[axis]), float(sigmas[axis])
        edges = (np.arange(voxels.shape[2 - axis] + 1) - 0.5) * spacing
        cumulative = 0.5 * erf((edges[None, :] - targets[axis][:, None]) / (np.sqrt(2) * sigma))
        weights = np.diff(cumulative, axis=1).astype(np.float32)
        weights[weights < 1e-7] = 0  # far tails: most of the matrix, and denormal products
        # Sparse, as the dense product's threads fight with those of other workers.
        values = _apply_along(sp.csr_array(weights), values, 2 - axis)
    return values


def volume_level(values: np.ndarray, organ: Mask, voxel_mm: float) -> float:
    """The level with as many grid points above it as fill the organ's volume.

    Raises CaseError if the grid is too coarse to hold the organ.
    """
    flat = values[values > 1e-3]
    count = round(organ.volume_mm3 / voxel_mm**3)
    if count < 1 or len(flat) < 2:
        raise CaseError(
            organ.case_id,
            f"a grid of {voxel_mm:g} mm is too coarse for an organ of {organ.volume_mm3:.3g} mm³. "
            "Lower meshing.voxel_mm or meshing.smoothing_mm, or set data.unit if the organ's size "
            "is wrong (masks in metres or centimetres).",
        )
    rank = int(np.clip(len(flat) - count, 1, len(flat) - 1))
    low, high = np.partition(flat, (rank - 1, rank))[[rank - 1, rank]]
    return float(low + high) / 2


def _apply_along(weights: sp.csr_array, values: np.ndarray, axis: int) -> np.ndarray:
    """weights (new, old) applied along one axis of values (Z, Y, X)."""
    if axis == 0:
        flat = values.reshape(values.shape[0], -1)
        returned: np.ndarray = (weights @ flat.astype(np.float32, copy=False)).reshape(
            -1, *values.shape[1:]
        )
        return returned
    shape = list(values.shape)
    shape[axis] = weights.shape[0]
    result = np.empty(shape, np.float32)
    for z, plane in enumerate(values):  # slice by slice: the float copy stays small
        plane = plane.astype(np.float32, copy=False)
        result[z] = weights @ plane if axis == 1 else (weights @ np.ascontiguousarray(plane.T)).T
    return result

"""Mask → smooth field on an isotropic grid, whose level set keeps the mask's volume."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.special import erf

from ssm_pipeline.records import CaseError, Mask

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


def smooth_field(organ: Mask, voxel_mm: float, smoothing_mm: float) -> SmoothField:
    """Blur the organ with a Gaussian (sigma in mm) and sample it on an isotropic grid.

    The mask is taken as piecewise constant over its voxels and the Gaussian is integrated over each
    of them, so that thick slices are treated as what they are. Sigma is at least 0.6 voxels along
    each axis: less leaves the slices visible as steps.

    Raises:
        CaseError: If the grid would be too large for memory.
    """
    margin = 4 * smoothing_mm + 2 * voxel_mm
    extent_mm = np.array(organ.voxels.shape[::-1]) * organ.spacing_mm
    points = np.prod(extent_mm / voxel_mm + 1)
    if points > _MAX_POINTS:
        raise CaseError(
            organ.case_id,
            f"a grid of {voxel_mm:g} mm over an organ of {np.round(extent_mm)} mm has {points:.1e} "
            f"points; at most {_MAX_POINTS:.0e} are taken. Raise voxel_mm.",
        )
    values = organ.voxels
    starts = np.empty(3)
    # The axis that shrinks most first: every later product is then smaller.
    for axis in np.argsort(organ.spacing_mm):
        spacing = float(organ.spacing_mm[axis])
        sigma = max(smoothing_mm, 0.6 * spacing)
        extent = (organ.voxels.shape[2 - axis] - 1) * spacing
        count = int(np.ceil((extent + 2 * margin) / voxel_mm)) + 1
        starts[axis] = (extent - (count - 1) * voxel_mm) / 2
        edges = (np.arange(organ.voxels.shape[2 - axis] + 1) - 0.5) * spacing
        targets = starts[axis] + voxel_mm * np.arange(count)
        cumulative = 0.5 * erf((edges[None, :] - targets[:, None]) / (np.sqrt(2) * sigma))
        weights = np.diff(cumulative, axis=1).astype(np.float32)
        weights[weights < 1e-7] = 0  # far tails: most of the matrix, and denormal products
        # Sparse, as the dense product's threads fight with those of other workers.
        values = _apply_along(sp.csr_array(weights), values, 2 - axis)
    return SmoothField(
        values=values,
        voxel_mm=voxel_mm,
        origin_mm=organ.origin_mm + organ.direction @ starts,
        direction=organ.direction,
        level=volume_level(values, organ.volume_mm3 / voxel_mm**3),
    )


def volume_level(values: np.ndarray, count: float) -> float:
    """The level that `count` of the grid points lie above."""
    flat = values[values > 1e-3]
    rank = int(np.clip(len(flat) - round(count), 1, len(flat) - 1))
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

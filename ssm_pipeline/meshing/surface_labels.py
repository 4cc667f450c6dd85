"""Labels of a mask's parts → the parts of its surface."""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from ssm_pipeline.records import CaseError, Mask, Mesh, SurfaceLabels

_SHELL = 3  # voxels below the border that a surface point can take its label from
_NEIGHBOURS = 48


def surface_labels(mesh: Mesh, mask: Mask) -> SurfaceLabels:
    """To which labelled part of the organ each vertex of its surface belongs.

    A vertex has the labels of the voxels around it, weighted by a Gaussian of one voxel's size
    about the nearest of them: the border between two parts then runs smoothly between voxels, where
    the nearest voxel's label alone would make it a staircase, and too long.

    Raises:
        CaseError: For a mask without labels, or whose organ has none.
    """
    if mask.labels is None:
        raise CaseError(mask.case_id, "the mask has no labels of parts. Name several in labels.")
    inner = ndimage.binary_erosion(mask.voxels, iterations=_SHELL)
    voxels = np.argwhere(mask.voxels & ~inner & (mask.labels > 0))
    if len(voxels) == 0:
        raise CaseError(mask.case_id, "no voxel of the organ has a label. Check the labels.")
    values, which = np.unique(mask.labels[tuple(voxels.T)], return_inverse=True)
    tree = cKDTree(mask.to_world(voxels[:, ::-1].astype(float)))
    count = min(_NEIGHBOURS, len(voxels))
    distances, nearest = tree.query(mesh.vertices, k=list(range(1, count + 1)))
    voxel_mm = float(np.prod(mask.spacing_mm)) ** (1 / 3)
    weights = np.exp(-(distances**2 - distances[:, :1] ** 2) / (2 * voxel_mm**2))
    shares = np.stack(
        [(weights * (which[nearest] == part)).sum(axis=1) for part in range(len(values))], axis=1
    )
    shares /= shares.sum(axis=1, keepdims=True)
    return SurfaceLabels(mesh.case_id, values.astype(np.int64), shares.astype(np.float32))

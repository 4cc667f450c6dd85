"""Smoothing of a closed mesh, and giving it back the volume it should have."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ssm_pipeline.geometry.surface import area, vertex_normals, volume
from ssm_pipeline.geometry.topology import directed_edges


def neighbour_mean(faces: np.ndarray, vertex_count: int) -> sp.csr_array:
    """(V, V) sparse: each row averages the vertex's one-ring (closed mesh), with equal weights."""
    edges = directed_edges(faces)
    ones = np.ones(len(edges))
    adjacency = sp.csr_array((ones, (edges[:, 0], edges[:, 1])), shape=(vertex_count, vertex_count))
    valence = np.maximum(adjacency.sum(axis=1), 1)
    return sp.csr_array(sp.diags_array(1 / valence) @ adjacency)


def laplacian_smoothing(
    vertices: np.ndarray, faces: np.ndarray, steps: int, step_size: float = 0.5
) -> np.ndarray:
    """(V, 3) after `steps` moves of `step_size` towards the mean of the neighbours. Shrinks."""
    mean = neighbour_mean(faces, len(vertices))
    for _ in range(steps):
        vertices = (1 - step_size) * vertices + step_size * (mean @ vertices)
    return vertices


def restore_volume(vertices: np.ndarray, faces: np.ndarray, volume_mm3: float) -> np.ndarray:
    """(V, 3) moved along the normals by one common distance to the volume, within 1e-6.

    A common distance, not a scaling: smoothing takes the same layer off a near and a far wall.
    """
    for _ in range(20):  # Newton; two or three steps do
        missing = volume_mm3 - volume(vertices, faces)
        if abs(missing) <= 1e-6 * volume_mm3:
            break
        vertices = vertices + missing / area(vertices, faces) * vertex_normals(vertices, faces)
    return vertices

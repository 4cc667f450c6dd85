"""Values at points inside triangles."""

from __future__ import annotations

import numpy as np


def interpolated(values: np.ndarray, corners: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Values between some vertices, each a weighted mean of its corners' values.

    Args:
        values: (…, V, D) at the vertices: positions, displacements, colours; any unit, kept.
        corners: (P, C) int: the vertices that point p lies between, C = 3 in a triangle.
        weights: (P, C) barycentric, rows sum to 1.

    Returns:
        (…, P, D). Linear in `values`: modes may be given as well as shapes.

    >>> triangle = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 3.0, 0.0]])
    >>> interpolated(triangle, np.array([[0, 1, 2]]), np.array([[1 / 3, 1 / 3, 1 / 3]]))
    array([[1., 1., 0.]])
    """
    total = values[..., corners[:, 0], :] * weights[:, 0, None]
    for corner in range(1, corners.shape[1]):
        total += values[..., corners[:, corner], :] * weights[:, corner, None]
    result: np.ndarray = total
    return result

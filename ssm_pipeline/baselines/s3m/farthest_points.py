"""Farthest-point sampling of a point cloud."""

from __future__ import annotations

import numpy as np


def farthest_points(points: np.ndarray, count: int, first: int | None = None) -> np.ndarray:
    """Indices (count,) of points (V, 3), each the farthest from all taken before it.

    Starts at `first`, or at the point farthest from the centroid, which does not depend on the
    order of the points.

    Raises:
        ValueError: For fewer points than requested.

    Source: Eldar et al. 1997.
    """
    if not 1 <= count <= len(points):
        raise ValueError(f"{count} points requested from {len(points)}")
    x, y, z = np.ascontiguousarray(points.T)  # rows lie together in memory
    if first is None:
        first = int(((points - points.mean(axis=0)) ** 2).sum(axis=1).argmax())
    taken = np.empty(count, dtype=np.int64)
    taken[0] = first
    nearest = np.full(len(points), np.inf)
    for step in range(1, count):
        last = taken[step - 1]
        squared = (x - x[last]) ** 2 + (y - y[last]) ** 2 + (z - z[last]) ** 2
        np.minimum(nearest, squared, out=nearest)
        taken[step] = nearest.argmax()
    return taken

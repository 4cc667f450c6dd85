"""The same points on every shape of a model, so that all are scored by equally many."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ssm_pipeline.geometry.barycentric import interpolated
from ssm_pipeline.geometry.surface import sample_surface


@dataclass(frozen=True, eq=False)
class FixedPoints:
    """P points that move with a shape's vertices.

    corners (P, 3) int: the vertices a point lies between; weights (P, 3), rows sum to 1.
    """

    corners: np.ndarray
    weights: np.ndarray

    @staticmethod
    def of(
        vertices: np.ndarray, faces: np.ndarray, count: int, generator: np.random.Generator
    ) -> FixedPoints:
        """`count` even points of a shape (V, 3), by area."""
        face, weights = sample_surface(vertices, faces, count, generator)
        order = spatial_order(interpolated(vertices, faces[face], weights))
        return FixedPoints(faces[face][order], weights[order])

    @property
    def count(self) -> int:
        return len(self.corners)

    def on(self, shapes: np.ndarray) -> np.ndarray:
        """(…, V, 3) → (…, P, 3). Linear: modes may be given as well as shapes."""
        return interpolated(shapes, self.corners, self.weights)


def spatial_order(points: np.ndarray) -> np.ndarray:
    """(P,) the order along a Morton curve: every k-th point is then an even subset.

    Also makes nearest-neighbour queries faster, since one after another visits the same memory.
    """
    extent = np.ptp(points, axis=0).max()
    cells = ((points - points.min(axis=0)) / (extent if extent > 0 else 1) * 1023).astype(np.int64)
    code = np.zeros(len(points), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")

"""The same points on every shape of a model, so that all are scored by equally many."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ssm_pipeline.geometry.surface import sample_surface


@dataclass(frozen=True)
class FixedPoints:
    """P points that move with a shape's vertices.

    corners (P, C) int: the vertices a point lies between (C = 3), or is (C = 1);
    weights (P, C), rows sum to 1.
    """

    corners: np.ndarray
    weights: np.ndarray

    @staticmethod
    def of(
        vertices: np.ndarray, faces: np.ndarray, count: int, generator: np.random.Generator
    ) -> FixedPoints:
        """`count` even points of a shape (V, 3), by area; or, where it has no faces (S3M's point
        clouds), the subset of its points farthest from each other, at most all V.
        """
        if len(faces):
            face, weights = sample_surface(vertices, faces, count, generator)
            order = spatial_order(np.einsum("pc,pcd->pd", weights, vertices[faces[face]]))
            return FixedPoints(faces[face][order], weights[order])
        subset = farthest_points(vertices, min(count, len(vertices)))
        return FixedPoints(subset[:, None], np.ones((len(subset), 1)))

    @property
    def count(self) -> int:
        return len(self.corners)

    def on(self, shapes: np.ndarray) -> np.ndarray:
        """(…, V, 3) → (…, P, 3). Linear: modes may be given as well as shapes."""
        return sum(
            shapes[..., self.corners[:, corner], :] * self.weights[:, corner, None]
            for corner in range(self.corners.shape[1])
        )


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


def farthest_points(points: np.ndarray, count: int) -> np.ndarray:
    """(count,) indices in spatial order; each was the farthest from those chosen before it.

    The first is the point farthest out.
    """
    chosen = np.empty(count, dtype=np.int64)
    nearest = np.full(len(points), np.inf)
    farthest = int(np.linalg.norm(points - points.mean(axis=0), axis=1).argmax())
    for index in range(count):
        chosen[index] = farthest
        nearest = np.minimum(nearest, ((points - points[farthest]) ** 2).sum(axis=1))
        farthest = int(nearest.argmax())
    return chosen[spatial_order(points[chosen])]

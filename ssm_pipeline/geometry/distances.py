"""Distances between surfaces, in the vertices' unit (millimetres in this project), unsquared."""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
from pykdtree.kdtree import KDTree


@dataclass(frozen=True, eq=False)
class PointTarget:
    """Points (P, 3) float32 with their k-d tree, built once and asked many times.

    In single precision, for speed: rounding moves a point 500 mm from the origin by 3e-5 mm.
    """

    points: np.ndarray
    tree: KDTree

    @staticmethod
    def of(points: np.ndarray) -> PointTarget:
        points = np.ascontiguousarray(points, dtype=np.float32)
        return PointTarget(points, KDTree(points, leafsize=16))

    def distances_to(self, queries: np.ndarray) -> np.ndarray:
        """(Q,) float32: from each query (Q, 3) to the nearest of the points."""
        distances, _ = self.tree.query(np.ascontiguousarray(queries, dtype=np.float32))
        result: np.ndarray = distances
        return result


@dataclass(frozen=True, eq=False)
class SurfaceTarget:
    """A mesh with the bounding-box tree of its triangles, built once and asked many times."""

    vertices: np.ndarray
    faces: np.ndarray
    tree: igl.AABB

    @staticmethod
    def of(vertices: np.ndarray, faces: np.ndarray) -> SurfaceTarget:
        vertices = np.ascontiguousarray(vertices, dtype=np.float64)
        faces = np.ascontiguousarray(faces, dtype=np.int64)
        tree = igl.AABB()
        tree.init(vertices, faces)
        return SurfaceTarget(vertices, faces, tree)

    def distances_to(self, queries: np.ndarray) -> np.ndarray:
        """(Q,) exact distance from each query (Q, 3) to the nearest point of the triangles."""
        queries = np.ascontiguousarray(queries, dtype=np.float64)
        squared = self.tree.squared_distance(self.vertices, self.faces, queries)[0]
        result: np.ndarray = np.sqrt(np.maximum(squared, 0))
        return result


@dataclass(frozen=True)
class SurfaceDistance:
    """Symmetric distance of two surfaces: mean, and 95th percentile (the larger direction's)."""

    mean: float
    hd95: float


def chamfer(a: PointTarget, b: PointTarget) -> float:
    """Mean of the two directed mean nearest-neighbour distances, unsquared.

    Between equally dense samples of one and the same surface it is not 0 but about half their
    spacing, √(area / count) / 2: a floor that no method can go below, to be stated beside it.
    """
    a_to_b, b_to_a = b.distances_to(a.points), a.distances_to(b.points)
    return float(0.5 * (a_to_b.mean(dtype=np.float64) + b_to_a.mean(dtype=np.float64)))


def symmetric(a_to_b: np.ndarray, b_to_a: np.ndarray) -> SurfaceDistance:
    """Of the distances of each surface's points to the other, (A,) and (B,).

    The mean is the mean of the two directed means, HD95 the larger of the two directed 95th
    percentiles, so that a small surface inside a large one can't look good.

    >>> symmetric(np.array([1.0, 1.0]), np.array([3.0, 3.0, 3.0]))
    SurfaceDistance(mean=2.0, hd95=3.0)
    """
    return SurfaceDistance(
        mean=float(0.5 * (a_to_b.mean() + b_to_a.mean())),
        hd95=float(max(np.percentile(a_to_b, 95), np.percentile(b_to_a, 95))),
    )


def surface_distance(a: SurfaceTarget, b: SurfaceTarget) -> SurfaceDistance:
    """From the vertices of each surface to the triangles of the other, both directions."""
    return symmetric(b.distances_to(a.vertices), a.distances_to(b.vertices))

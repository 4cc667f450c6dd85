"""Nearest points on a triangle mesh."""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np


@dataclass(frozen=True, eq=False)
class ClosestPoints:
    """points (Q, 3); faces (Q,) int; barycentric (Q, 3); distances (Q,), the mesh's unit."""

    points: np.ndarray
    faces: np.ndarray
    barycentric: np.ndarray
    distances: np.ndarray


def closest_points(
    queries: np.ndarray, vertices: np.ndarray, faces: np.ndarray, tree: igl.AABB | None = None
) -> ClosestPoints:
    """For each query (Q, 3) its exact nearest point on the mesh's triangles (AABB tree).

    Args:
        tree: Of the same mesh (`SurfaceTarget.tree`), where it is asked many times; None: built
            here.
    """
    queries = np.ascontiguousarray(queries, dtype=np.float64)
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    faces = np.ascontiguousarray(faces, dtype=np.int64)
    if tree is None:
        squared, face, points = igl.point_mesh_squared_distance(queries, vertices, faces)
    else:
        squared, face, points = tree.squared_distance(vertices, faces, queries)
    corners = vertices[faces[face]]
    weights = igl.barycentric_coordinates(
        np.ascontiguousarray(points),
        *(np.ascontiguousarray(corners[:, corner]) for corner in range(3)),
    )
    # A triangle without area (a matched template can have some) has no barycentric coordinates:
    # there, the nearest corner stands for the point.
    flat = ~np.isfinite(weights).all(axis=1)
    nearest = np.linalg.norm(corners[flat] - points[flat, None], axis=2).argmin(axis=1)
    weights[flat] = np.eye(3)[nearest]
    weights = np.clip(weights, 0, None)  # round-off on edges
    weights /= weights.sum(axis=1, keepdims=True)
    return ClosestPoints(points, face.astype(np.int64), weights, np.sqrt(np.maximum(squared, 0)))

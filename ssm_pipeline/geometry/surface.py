"""Area, normals and even sampling of a triangle mesh."""

from __future__ import annotations

import numpy as np

from ssm_pipeline.geometry.barycentric import interpolated
from ssm_pipeline.geometry.similarity import Similarity


def face_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F, 3) unit normals, outward; a triangle without area has zero.

    >>> face_normals(np.array([[0.0, 0, 0], [3, 0, 0], [0, 3, 0]]), np.array([[0, 1, 2]]))
    array([[0., 0., 1.]])
    """
    return _unit(_normals_times_twice_area(vertices, faces))


def face_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F,) in the vertices' unit, squared."""
    result: np.ndarray = 0.5 * np.linalg.norm(_normals_times_twice_area(vertices, faces), axis=1)
    return result


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V, 3) unit normals, area-weighted; a vertex without triangles, or whose cancel, has zero."""
    of_faces = _normals_times_twice_area(vertices, faces)
    corners = faces.ravel()
    sums = [np.bincount(corners, np.repeat(of_faces[:, d], 3), len(vertices)) for d in range(3)]
    normals = np.stack(sums, axis=1)
    around = np.bincount(corners, np.repeat(np.linalg.norm(of_faces, axis=1), 3), len(vertices))
    normals[np.linalg.norm(normals, axis=1) < 1e-9 * around] = 0  # round-off has no direction
    return _unit(normals)


def area(vertices: np.ndarray, faces: np.ndarray) -> float:
    """The surface's whole area, in the vertices' unit, squared."""
    return float(face_areas(vertices, faces).sum())


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Signed volume of a closed mesh (divergence theorem): positive when oriented outward."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return float(np.einsum("fd,fd->", a, np.cross(b, c)) / 6)


def centroid(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(3,) centre of the surface, area-weighted: does not move with the triangulation."""
    weights = face_areas(vertices, faces)
    return np.average(vertices[faces].mean(axis=1), axis=0, weights=weights)


def unit_area_frame(vertices: np.ndarray, faces: np.ndarray) -> Similarity:
    """From unit area, centred, to where the surface lies and how large it is.

    >>> corners = np.array([[5.0, 0, 0], [8, 0, 0], [5, 6, 0]])
    >>> unit_area_frame(corners, np.array([[0, 1, 2]])).inverse().apply(corners)[0]
    array([-0.33333333, -0.66666667,  0.        ])
    """
    size = float(np.sqrt(area(vertices, faces)))
    return Similarity(size, np.eye(3), centroid(vertices, faces))


def sample_surface(
    vertices: np.ndarray, faces: np.ndarray, count: int, generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Even random points on a surface, stratified over its area.

    Returns:
        (count,) face indices and (count, 3) barycentric weights: the points are
        `interpolated(vertices, faces[face], barycentric)`, and move with the vertices.
    """
    cumulative = np.cumsum(face_areas(vertices, faces))
    # One draw in each of `count` equal strips of area: far less clumping than free draws.
    strips = (np.arange(count) + generator.random(count)) / count * cumulative[-1]
    face = np.minimum(np.searchsorted(cumulative, strips, side="right"), len(faces) - 1)
    root, second = np.sqrt(generator.random(count)), generator.random(count)
    return face, np.stack([1 - root, root * (1 - second), root * second], axis=1)


def sample_points(
    vertices: np.ndarray, faces: np.ndarray, count: int, generator: np.random.Generator
) -> np.ndarray:
    """(count, 3) even random points on the surface."""
    face, weights = sample_surface(vertices, faces, count, generator)
    return interpolated(vertices, faces[face], weights)


def _normals_times_twice_area(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return np.cross(b - a, c - a)


def _unit(vectors: np.ndarray) -> np.ndarray:
    result: np.ndarray = vectors / np.maximum(
        np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300
    )
    return result

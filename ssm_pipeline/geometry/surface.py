"""Area, normals and even sampling of a triangle mesh."""

from __future__ import annotations

import numpy as np


def face_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F, 3) outward normals with length twice the triangle's area."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return np.cross(b - a, c - a)


def face_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F,) in the vertices' unit, squared."""
    return 0.5 * np.linalg.norm(face_normals(vertices, faces), axis=1)


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V, 3) unit normals, area-weighted; a vertex without triangles keeps zero."""
    of_faces = face_normals(vertices, faces)
    corners = faces.ravel()
    sums = [np.bincount(corners, np.repeat(of_faces[:, d], 3), len(vertices)) for d in range(3)]
    normals = np.stack(sums, axis=1)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)


def area(vertices: np.ndarray, faces: np.ndarray) -> float:
    return float(face_areas(vertices, faces).sum())


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Signed volume of a closed mesh (divergence theorem): positive when oriented outward."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return float(np.einsum("fd,fd->", a, np.cross(b, c)) / 6)


def centroid(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(3,) centre of the surface, area-weighted: does not move with the triangulation."""
    weights = face_areas(vertices, faces)
    return np.average(vertices[faces].mean(axis=1), axis=0, weights=weights)


def sample_surface(
    vertices: np.ndarray, faces: np.ndarray, count: int, generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Even random points on a surface, stratified over its area.

    Returns (count,) face indices and (count, 3) barycentric weights: the points are
    `einsum('sc,scd->sd', barycentric, vertices[faces[face]])`, and move with the vertices.
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
    return np.einsum("sc,scd->sd", weights, vertices[faces[face]])

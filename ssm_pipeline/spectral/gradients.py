"""Per-vertex tangential gradient operators, in closed form."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ssm_pipeline.geometry.surface import vertex_normals
from ssm_pipeline.geometry.topology import edges


def one_ring_edges(faces: np.ndarray) -> np.ndarray:
    """(E, 2) int: every edge of the mesh once in each direction, sorted by its start."""
    once = edges(faces)
    both = np.concatenate([once, once[:, ::-1]])
    return both[np.lexsort((both[:, 1], both[:, 0]))]


def any_unit_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V, 3) unit normals; a vertex whose triangles cancel takes its neighbours', or the z axis.

    Meshes of the literature have such vertices: a fold of no thickness, a flat sliver, a vertex
    without triangles.
    """
    normals = vertex_normals(vertices, faces)
    missing = ~(np.linalg.norm(normals, axis=1) > 0.5)
    if missing.any():
        start, end = one_ring_edges(faces).T
        around = np.zeros_like(normals)
        np.add.at(around, start, np.where(missing[end, None], 0, normals[end]))
        length = np.linalg.norm(around, axis=1, keepdims=True)
        found = np.divide(around, length, out=np.zeros_like(around), where=length > 1e-6)
        found[length[:, 0] <= 1e-6] = [0.0, 0.0, 1.0]
        normals[missing] = found[missing]
    return normals


def gradient_operators(
    vertices: np.ndarray, faces: np.ndarray, regularisation: float = 1e-5
) -> tuple[sp.csr_matrix, sp.csr_matrix]:
    """The two components of the gradient in a tangent frame at each vertex, (V, V) sparse each.

    At vertex i the gradient is the g that minimises Σ_j (e_ij·g − (f_j − f_i))² over its one-ring,
    e_ij the edge flattened into the tangent plane. The 2×2 normal equations are inverted in closed
    form for all vertices at once. The frame's direction is arbitrary: what uses these operators
    must not depend on it. Source: Sharp et al. 2022, section 3.3; there solved vertex by vertex.
    """
    normals = any_unit_normals(vertices, faces)
    # Any direction that is not along the normal gives a frame: the axis it is least along.
    axis = np.eye(3)[np.abs(normals).argmin(axis=1)]
    frame_x = np.cross(normals, axis)
    frame_x /= np.linalg.norm(frame_x, axis=1, keepdims=True)
    frame_y = np.cross(normals, frame_x)

    start, end = one_ring_edges(faces).T
    edge = vertices[end] - vertices[start]
    x = np.einsum("ed,ed->e", edge, frame_x[start])
    y = np.einsum("ed,ed->e", edge, frame_y[start])
    # Flattening keeps the edge's length (it is laid down, not projected).
    stretch = np.linalg.norm(edge, axis=1) / np.maximum(np.hypot(x, y), 1e-30)
    x, y = x * stretch, y * stretch

    count = len(vertices)
    xx, xy, yy = (np.bincount(start, product, count) for product in (x * x, x * y, y * y))
    # Relative, where DiffusionNet's is absolute: the operator scales with the mesh exactly.
    extra = regularisation * 0.5 * (xx + yy)
    xx, yy = xx + extra, yy + extra
    determinant = xx * yy - xy**2
    # A ring of no extent (all its vertices in one place) has no gradient: zero, not infinite.
    inverse = np.zeros(count)
    np.divide(1, determinant, out=inverse, where=determinant > 1e-30 * (xx + yy) ** 2)
    inverse[~np.isfinite(inverse)] = 0
    weight_x = (yy[start] * x - xy[start] * y) * inverse[start]
    weight_y = (xx[start] * y - xy[start] * x) * inverse[start]

    def operator(weights: np.ndarray) -> sp.csr_matrix:
        off_diagonal = sp.csr_matrix((weights, (start, end)), shape=(count, count))
        return (off_diagonal - sp.diags(np.bincount(start, weights, count))).tocsr()

    return operator(weight_x), operator(weight_y)

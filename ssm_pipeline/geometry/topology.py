"""Is a triangle mesh a closed, oriented manifold, and of which genus?"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components


def directed_edges(faces: np.ndarray) -> np.ndarray:
    """(3F, 2): the edges of each face in its own direction; row c·F + f starts at corner c."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def edges(faces: np.ndarray) -> np.ndarray:
    """(E, 2): every edge once, its lower vertex first, in ascending order.

    >>> edges(np.array([[0, 1, 2], [2, 1, 3]])).tolist()
    [[0, 1], [0, 2], [1, 2], [1, 3], [2, 3]]
    """
    count = int(faces.max()) + 1
    keys = np.unique(_undirected_keys(faces))
    return np.stack([keys // count, keys % count], axis=1)


def opposite_edges(faces: np.ndarray) -> np.ndarray:
    """(3F,) for each row of `directed_edges` the row that runs the other way; −1 on a boundary.

    For meshes whose edges have at most two faces, oriented alike.
    """
    directed = directed_edges(faces)
    count = int(faces.max()) + 1
    forward = directed[:, 0] * count + directed[:, 1]
    backward = directed[:, 1] * count + directed[:, 0]
    order = np.argsort(forward)
    found = order[np.minimum(np.searchsorted(forward[order], backward), len(forward) - 1)]
    return np.where(forward[found] == backward, found, -1)


def euler_number(faces: np.ndarray) -> int:
    """V − E + F over the vertices in use: 2 − 2·genus for one closed surface, 2 for a sphere."""
    return len(np.unique(faces)) - len(np.unique(_undirected_keys(faces))) + len(faces)


def boundary_edges(faces: np.ndarray) -> np.ndarray:
    """(B, 2) directed edges that belong to one face only; empty for a closed mesh."""
    _, inverse, count = np.unique(_undirected_keys(faces), return_inverse=True, return_counts=True)
    result: np.ndarray = directed_edges(faces)[count[inverse] == 1]
    return result


def boundary_loop_count(faces: np.ndarray) -> int:
    """The number of connected chains of boundary edges: holes. 0 for a closed mesh."""
    rim = boundary_edges(faces)
    if len(rim) == 0:
        return 0
    _, local = np.unique(rim, return_inverse=True)
    return _component_count(local.reshape(rim.shape), local.max() + 1)


def is_oriented_manifold(faces: np.ndarray) -> bool:
    """True if the mesh is closed, every edge has two faces of agreeing orientation, and the
    faces around every vertex form one fan."""
    directed = directed_edges(faces)
    forward = directed[:, 0] * (int(faces.max()) + 1) + directed[:, 1]
    if len(np.unique(forward)) < len(forward):
        return False  # an edge is used twice in one direction
    opposite = opposite_edges(faces)
    if (opposite < 0).any():
        return False  # a boundary edge, or an edge with three faces
    # Corner c of face f is node c·F + f. Across the edge a→b of one face and b→a of the other,
    # their corners at a, and at b, belong to one fan; as many fans as vertices is what's needed.
    count = len(faces)
    corner = np.arange(3 * count)
    following = (corner + count) % (3 * count)  # the corner at the end of the edge
    links = np.stack([corner, following[opposite]], axis=1)
    return _component_count(links, 3 * count) == len(np.unique(faces))


def face_components(faces: np.ndarray) -> np.ndarray:
    """(F,) int: which connected piece of the surface each face belongs to."""
    directed = directed_edges(faces)
    count = int(faces.max()) + 1
    graph = sp.coo_matrix((np.ones(len(directed), bool), directed.T), shape=(count, count))
    result: np.ndarray = connected_components(graph, directed=False)[1][faces[:, 0]]
    return result


def submesh_faces(faces: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """(F', 3): the faces all of whose corners are among `vertices` (K,), numbered as there.

    >>> submesh_faces(np.array([[0, 1, 2], [1, 3, 2]]), np.array([3, 2, 1]))
    array([[2, 0, 1]])
    """
    number = np.full(int(faces.max(initial=-1)) + 1, -1)
    inside = np.flatnonzero(vertices < len(number))
    number[vertices[inside]] = inside
    renumbered = number[faces]
    result: np.ndarray = renumbered[(renumbered >= 0).all(axis=1)]
    return result


def min_angle_deg(vertices: np.ndarray, faces: np.ndarray) -> float:
    """The smallest inner angle of any triangle, degrees."""
    corners = vertices[faces]
    smallest = np.inf
    for corner in range(3):
        to_next = corners[:, (corner + 1) % 3] - corners[:, corner]
        to_last = corners[:, (corner + 2) % 3] - corners[:, corner]
        sine = np.linalg.norm(np.cross(to_next, to_last), axis=1)
        cosine = np.einsum("fd,fd->f", to_next, to_last)
        smallest = min(smallest, float(np.arctan2(sine, cosine).min()))
    return float(np.degrees(smallest))


def _undirected_keys(faces: np.ndarray) -> np.ndarray:
    """(3F,) one number an edge, the same from both sides: sorts ten times faster than pairs."""
    directed = directed_edges(faces)
    result: np.ndarray = directed.min(axis=1) * (int(faces.max()) + 1) + directed.max(axis=1)
    return result


def _component_count(links: np.ndarray, node_count: int) -> int:
    graph = sp.coo_matrix((np.ones(len(links), bool), links.T), shape=(node_count, node_count))
    return int(connected_components(graph, directed=False)[0])

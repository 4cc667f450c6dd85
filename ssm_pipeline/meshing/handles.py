"""Make a closed surface a topological sphere by cutting its handles."""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components, dijkstra, minimum_spanning_tree

from ssm_pipeline.geometry.topology import directed_edges, euler_number, opposite_edges
from ssm_pipeline.meshing.smoothing import laplacian_smoothing
from ssm_pipeline.records import Mesh

_RESTARTS = 3  # roots tried along the loop found so far


@dataclass(frozen=True, eq=False)
class Handle:
    """A handle that was cut.

    Attributes:
        loop_mm: Length of the loop along which the surface was cut.
        centre_mm: (3,) the middle of the loop.
        is_filled: True if the hole was filled, False if the bridge around it was cut.
    """

    loop_mm: float
    centre_mm: np.ndarray
    is_filled: bool


def cut_handles(mesh: Mesh) -> tuple[Mesh, tuple[Handle, ...]]:
    """Cut the surface along its shortest non-separating loops until it has genus 0.

    A loop around a thin bridge cuts the bridge; a loop around a hole fills the hole: the shorter
    one is the smaller change. Both ends of the cut are closed by a fan of triangles, and the fans
    are smoothed.

    Args:
        mesh: One closed, oriented manifold piece.

    Returns:
        The mesh, and what was cut: as many handles as the genus before.

    Source: the loops are those of a tree-cotree decomposition (Eppstein 2003; Erickson and
    Whittlesey 2005), the shortest of a few roots rather than of all.
    """
    handles = []
    while euler_number(mesh.faces) < 2:
        loop = _short_loop(mesh)
        points = mesh.vertices[loop]
        steps = np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1)
        centre = points.mean(axis=0)
        inside = igl.winding_number(mesh.vertices, mesh.faces, centre[None])[0] > 0.5
        handles.append(Handle(float(steps.sum()), centre, not inside))
        mesh = _cut_along(mesh, loop)
    return mesh, tuple(handles)


def _short_loop(mesh: Mesh) -> np.ndarray:
    """(L,) vertices of a short simple loop that does not separate the surface."""
    best = min(_loops_through(mesh, int(mesh.faces[0, 0])), key=lambda loop: loop[0])
    for _ in range(3):
        loop = best[1]
        for root in loop[:: max(1, len(loop) // _RESTARTS)]:
            best = min([best, *_loops_through(mesh, int(root))], key=lambda loop: loop[0])
        if len(best[1]) == len(loop) and (best[1] == loop).all():
            break
    return best[1]


def _loops_through(mesh: Mesh, root: int) -> list[tuple[float, np.ndarray]]:
    """(length mm, vertices) of the 2·genus loops that a shortest-path tree from `root` leaves.

    An edge in neither the tree nor the tree of faces that crosses all other edges closes a loop
    that does not separate the surface. Among face trees the one that crosses the edges of long
    loops leaves the short ones.
    """
    face_count, vertex_count = len(mesh.faces), len(mesh.vertices)
    directed = directed_edges(mesh.faces)
    lengths = np.linalg.norm(mesh.vertices[directed[:, 0]] - mesh.vertices[directed[:, 1]], axis=1)
    graph = sp.csr_array((lengths, directed.T), shape=(vertex_count, vertex_count))
    distance, parent = dijkstra(graph, directed=False, indices=root, return_predecessors=True)
    first, second, (tail, head) = _faces_across(mesh.faces)
    off_tree = (parent[tail] != head) & (parent[head] != tail)
    edge_length = np.linalg.norm(mesh.vertices[tail] - mesh.vertices[head], axis=1)
    loop_length = distance[tail] + distance[head] + edge_length
    # Positive weights, as scipy drops zeros; small for long loops, which the tree takes first.
    weight = 2 * loop_length.max() - loop_length
    # Two faces may share two edges: a matrix would add their weights, so keep only the longer.
    index = np.flatnonzero(off_tree)
    index = index[np.lexsort((weight[index], second[index], first[index]))]
    pair = first[index] * face_count + second[index]
    leading = np.r_[True, pair[1:] != pair[:-1]]
    candidates = index[leading]
    dual = sp.csr_array(
        (weight[candidates], (first[candidates], second[candidates])),
        shape=(face_count, face_count),
    )
    chosen = minimum_spanning_tree(dual).tocoo()
    crossed = (
        np.isin(
            first[index] * face_count + second[index],
            chosen.row.astype(np.int64) * face_count + chosen.col,
        )
        & leading
    )
    loops = []
    for edge in index[~crossed]:
        there, back = _path(parent, tail[edge]), _path(parent, head[edge])
        while len(there) > 1 and len(back) > 1 and there[-2] == back[-2]:
            there.pop()
            back.pop()
        loop = np.array(there[:-1] + back[::-1])
        steps = mesh.vertices[loop] - mesh.vertices[np.roll(loop, 1)]
        loops.append((float(np.linalg.norm(steps, axis=1).sum()), loop))
    return loops


def _path(parent: np.ndarray, vertex: int) -> list[int]:
    path = [int(vertex)]
    while parent[path[-1]] >= 0:
        path.append(int(parent[path[-1]]))
    return path


def _faces_across(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For every edge once: its lower and higher face (E,) and its two vertices (2, E)."""
    directed = directed_edges(faces)
    owner = np.tile(np.arange(len(faces)), 3)
    undirected = np.sort(directed, axis=1)
    order = np.lexsort((owner, undirected[:, 1], undirected[:, 0]))
    return owner[order[::2]], owner[order[1::2]], undirected[order[::2]].T


def _cut_along(mesh: Mesh, loop: np.ndarray) -> Mesh:
    """Open the surface along the loop and close both ends with a fan of triangles."""
    faces = mesh.faces
    count, vertex_count = len(faces), len(mesh.vertices)
    directed = directed_edges(faces)
    key = directed[:, 0] * vertex_count + directed[:, 1]
    opposite = opposite_edges(faces)
    following_loop = np.roll(loop, -1)
    on_loop = np.isin(
        key, np.r_[loop * vertex_count + following_loop, following_loop * vertex_count + loop]
    )
    # The corners around a vertex hang together across edges, except across the loop's: a vertex
    # on the loop falls into two.
    corner = np.arange(3 * count)
    following = (corner + count) % (3 * count)
    linked = corner[~on_loop]
    graph = sp.coo_array(
        (np.ones(len(linked), bool), (linked, following[opposite[linked]])),
        shape=(3 * count, 3 * count),
    )
    corner_vertex = connected_components(graph, directed=False)[1]
    new_faces = corner_vertex.reshape(3, count).T.astype(np.int64)
    vertices = np.empty((corner_vertex.max() + 1, 3))
    vertices[corner_vertex] = mesh.vertices[directed[:, 0]]

    rim = np.stack([corner_vertex, corner_vertex[following]], axis=1)[on_loop]
    _, local = np.unique(rim, return_inverse=True)
    pairs = local.reshape(rim.shape)
    side = connected_components(
        sp.coo_array((np.ones(len(pairs), bool), pairs.T), shape=(local.max() + 1,) * 2),
        directed=False,
    )[1][pairs[:, 0]]
    centre = mesh.vertices[loop].mean(axis=0)
    fans = np.column_stack([rim[:, 1], rim[:, 0], len(vertices) + side])
    vertices = np.concatenate([vertices, [centre, centre]])
    new_faces = np.concatenate([new_faces, fans])
    return Mesh(_smooth_near(vertices, new_faces, np.unique(fans)), new_faces, mesh.case_id)


def _smooth_near(vertices: np.ndarray, faces: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """Laplacian smoothing of the seeds and their neighbours: draws the two fans apart."""
    near = np.zeros(len(vertices), bool)
    near[seeds] = True
    near[faces[near[faces].any(axis=1)]] = True
    smooth = laplacian_smoothing(vertices, faces, steps=10)
    return np.where(near[:, None], smooth, vertices)

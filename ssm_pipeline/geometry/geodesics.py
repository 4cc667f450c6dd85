"""Geodesic distances on a triangle mesh: all pairs, from some vertices, between points.

Distances are lengths of shortest paths in a graph whose edges are straight lines on the surface:
from each vertex, the triangles around it are unfolded into the plane, strip by strip, and every
vertex seen in a straight line joins it. So each distance is the length of a real path, never
shorter than the mesh's own geodesic. Source: unfolding, Chen and Han 1990; graph of direct
geodesics, Ying, Wang and He 2013.

It is most exact where distances are short, which is where a good matcher's errors lie.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from ssm_pipeline.geometry.closest_point import ClosestPoints
from ssm_pipeline.geometry.topology import directed_edges, opposite_edges

STRIPS = 5  # triangles unfolded beyond a vertex's own ring; balances error and time
_CHUNK = 256  # sources a Dijkstra call: bounds the dense block to 256 × V numbers


class _Windows(NamedTuple):
    """What sources see through edges a → b, (W,) each.

    In the plane of the unfolded strip a is the origin, b lies on the positive x axis, the source
    below it (y < 0), at `seen_from` (W, 2); the window is the interval [low, high] of that axis.
    """

    edge: np.ndarray
    source: np.ndarray
    seen_from: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def where(self, kept: np.ndarray) -> _Windows:
        return _Windows(*(part[kept] for part in self))


def straight_line_graph(
    vertices: np.ndarray, faces: np.ndarray, strips: int = STRIPS
) -> sp.csr_matrix:
    """(V, V) symmetric sparse lengths of the straight lines between nearby vertices.

    vertices (V, 3), faces (F, 3) of a manifold, oriented mesh (open or closed). `strips` = 0
    leaves the mesh's edges alone; each more unfolds one triangle further.
    """
    halfedges = directed_edges(faces)
    opposite = np.concatenate([faces[:, 2], faces[:, 0], faces[:, 1]])
    across = opposite_edges(faces)
    lengths = np.linalg.norm(vertices[halfedges[:, 1]] - vertices[halfedges[:, 0]], axis=1)
    lengths = np.maximum(lengths, 1e-12 * lengths.max())  # vertices in the same place are two

    rows, columns, weights = [halfedges[:, 0]], [halfedges[:, 1]], [lengths]
    edge = np.arange(len(halfedges))
    below = _apex(vertices, halfedges, opposite, lengths, edge) * [1, -1]
    windows = _Windows(edge, opposite, below, np.zeros(len(edge)), lengths.copy())
    for _ in range(strips):
        width = windows.high - windows.low
        open_ahead = (across[windows.edge] >= 0) & (width > 1e-12 * lengths[windows.edge])
        windows = windows.where(open_ahead)
        twin, seen_from = across[windows.edge], windows.seen_from
        # The twin runs b → a, so its triangle's apex is mirrored along x.
        apex = _apex(vertices, halfedges, opposite, lengths, twin)
        apex[:, 0] = lengths[windows.edge] - apex[:, 0]
        crossing = seen_from[:, 0] + (apex[:, 0] - seen_from[:, 0]) * (
            -seen_from[:, 1] / (apex[:, 1] - seen_from[:, 1])
        )
        seen = (crossing >= windows.low) & (crossing <= windows.high)
        rows.append(windows.source[seen])
        columns.append(opposite[twin[seen]])
        weights.append(np.linalg.norm(apex - seen_from, axis=1)[seen])
        windows = _through(windows._replace(edge=twin), apex, crossing, lengths)
    return _symmetric_minimum(
        np.concatenate(rows), np.concatenate(columns), np.concatenate(weights), len(vertices)
    )


def geodesics_from(
    vertices: np.ndarray, faces: np.ndarray, sources: np.ndarray, limit: float = np.inf
) -> np.ndarray:
    """(S, V) distances from the vertices `sources` (S,), the mesh's unit.

    inf beyond `limit` and on other components.
    """
    graph = straight_line_graph(vertices, faces)
    result: np.ndarray = dijkstra(graph, directed=True, indices=np.asarray(sources), limit=limit)
    return result


def geodesic_matrix(
    vertices: np.ndarray, faces: np.ndarray, across_gaps: bool = False
) -> np.ndarray:
    """(V, V) float32 distances between all vertices, symmetric; inf between components.

    Args:
        across_gaps: Join the components by `bridges`, so that every distance is finite.
    """
    graph = straight_line_graph(vertices, faces)
    if across_gaps:
        a, b = bridges(vertices, faces).T
        lengths = np.linalg.norm(vertices[a] - vertices[b], axis=1)
        lengths = np.maximum(lengths, 1e-12 * np.ptp(vertices))  # 0 would be no edge
        gaps = sp.csr_matrix((lengths, (a, b)), shape=graph.shape)
        graph = (graph + gaps + gaps.T).tocsr()
    matrix = np.empty((len(vertices), len(vertices)), dtype=np.float32)
    for start in range(0, len(vertices), _CHUNK):
        chunk = np.arange(start, min(start + _CHUNK, len(vertices)))
        matrix[chunk] = dijkstra(graph, directed=True, indices=chunk)
    return matrix


def bridges(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(B, 2) int pairs of vertices: the shortest straight lines from each other component, and
    each vertex without triangles, to the component with the most vertices. None: one component.
    """
    edges = directed_edges(faces)
    shape = (len(vertices), len(vertices))
    graph = sp.coo_matrix((np.ones(len(edges), bool), edges.T), shape=shape)
    count, piece = connected_components(graph, directed=False)
    main = np.bincount(piece).argmax()
    on_main = np.flatnonzero(piece == main)
    away = np.flatnonzero(piece != main)
    if count == 1:
        return np.empty((0, 2), dtype=np.int64)
    distance, nearest = cKDTree(vertices[on_main]).query(vertices[away])
    order = np.lexsort((distance, piece[away]))
    _, first = np.unique(piece[away][order], return_index=True)
    return np.stack([away[order][first], on_main[nearest[order][first]]], axis=1)


def geodesics_between(
    vertices: np.ndarray, faces: np.ndarray, start: ClosestPoints, end: ClosestPoints
) -> np.ndarray:
    """(Q,) distances between points on the mesh, pair by pair, the mesh's unit.

    The path runs between the two points' nearest corners a and b, corrected to the points
    themselves: d(p, q) ≈ |p − q| + d(a, b) − |a − b|. The excess of the geodesic over the straight
    line varies slowly, so this has no bias of an edge's length where the points are close; it is
    never below |p − q|. The search stops a little beyond each pair, so it costs what the errors
    measure and not the whole mesh.
    """
    corner_a = faces[start.faces, start.barycentric.argmax(axis=1)]
    corner_b = faces[end.faces, end.barycentric.argmax(axis=1)]
    chord = np.linalg.norm(vertices[corner_a] - vertices[corner_b], axis=1)
    graph = straight_line_graph(vertices, faces)
    between = np.empty(len(chord))
    order = np.argsort(chord)  # near pairs together, so that a block's limit suits all of it
    for first in range(0, len(order), _CHUNK):
        block = order[first : first + _CHUNK]
        between[block] = _between_vertices(graph, corner_a[block], corner_b[block], chord[block])
    straight = np.linalg.norm(start.points - end.points, axis=1)
    result: np.ndarray = straight + np.maximum(between - chord, 0)
    return result


def _between_vertices(
    graph: sp.csr_matrix, a: np.ndarray, b: np.ndarray, chord: np.ndarray
) -> np.ndarray:
    """Graph distances between vertex pairs; the search widens until every pair is met."""
    result = np.where(a == b, 0.0, np.inf)
    limit = 1.5 * chord.max()
    missing = np.flatnonzero(a != b)
    while len(missing):
        sources, position = np.unique(a[missing], return_inverse=True)
        result[missing] = dijkstra(graph, indices=sources, limit=limit)[position, b[missing]]
        missing = missing[np.isinf(result[missing])]
        if np.isinf(limit):
            break  # another component: the distance is infinite
        limit = 4 * limit if limit < 8 * chord.max() else np.inf
    return result


def _apex(
    vertices: np.ndarray,
    halfedges: np.ndarray,
    opposite: np.ndarray,
    lengths: np.ndarray,
    edge: np.ndarray,
) -> np.ndarray:
    """(E, 2) the third corner of each halfedge's triangle, a at the origin and b along x."""
    a, b = vertices[halfedges[edge, 0]], vertices[halfedges[edge, 1]]
    side = vertices[opposite[edge]] - a
    x = np.einsum("ed,ed->e", side, b - a) / lengths[edge]
    height = np.sqrt(np.maximum(np.einsum("ed,ed->e", side, side) - x**2, 0))
    return np.stack([x, np.maximum(height, 1e-12 * lengths[edge])], axis=1)


def _through(
    windows: _Windows, apex: np.ndarray, crossing: np.ndarray, lengths: np.ndarray
) -> _Windows:
    """The windows on the two far edges of the triangle beyond each window.

    `windows.edge` is the twin b → a; its triangle's next halfedge a → apex, the one after
    apex → b. crossing (W,): where the line from source to apex meets the window's axis.
    """
    twin, source, seen_from, low, high = windows
    count = len(lengths)
    after, before = (twin + count // 3) % count, (twin + 2 * count // 3) % count
    origin = np.zeros_like(apex)
    far_end = np.stack([lengths[twin], np.zeros(len(twin))], axis=1)
    pieces = []
    # Each is crossed from inside this triangle: as the halfedge of this triangle, left of it.
    for halfedge, first, last, start, stop in (
        (after, origin, apex, low, np.minimum(high, crossing)),
        (before, apex, far_end, np.maximum(low, crossing), high),
    ):
        direction = (last - first) / lengths[halfedge][:, None]
        offset = seen_from - first
        moved = np.stack(
            [
                np.einsum("ed,ed->e", offset, direction),
                direction[:, 0] * offset[:, 1] - direction[:, 1] * offset[:, 0],
            ],
            axis=1,
        )
        moved[:, 1] = -np.abs(moved[:, 1])
        ends = [
            _project(seen_from, bound, first, direction, lengths[halfedge])
            for bound in (start, stop)
        ]
        keep = (stop > start) & (moved[:, 1] < 0)
        found = _Windows(halfedge, source, moved, np.minimum(*ends), np.maximum(*ends))
        pieces.append(found.where(keep))
    return _Windows(*(np.concatenate(parts) for parts in zip(*pieces, strict=True)))


def _project(
    seen_from: np.ndarray,
    bound: np.ndarray,
    first: np.ndarray,
    direction: np.ndarray,
    length: np.ndarray,
) -> np.ndarray:
    """Where the ray through (bound, 0) meets the edge, as a length along it, within [0, length]."""
    ray = np.stack([bound - seen_from[:, 0], -seen_from[:, 1]], axis=1)
    offset = first - seen_from
    cross = ray[:, 0] * direction[:, 1] - ray[:, 1] * direction[:, 0]
    along = (offset[:, 0] * ray[:, 1] - offset[:, 1] * ray[:, 0]) / np.where(cross == 0, 1, cross)
    return np.clip(np.where(cross == 0, 0, along), 0, length)


def _symmetric_minimum(
    rows: np.ndarray, columns: np.ndarray, weights: np.ndarray, count: int
) -> sp.csr_matrix:
    """The shortest of each pair's lengths, stored both ways."""
    keys = np.minimum(rows, columns) * count + np.maximum(rows, columns)
    order = np.lexsort((weights, keys))
    keys, weights = keys[order], weights[order]
    first = np.concatenate([[True], keys[1:] != keys[:-1]])
    i, j, w = keys[first] // count, keys[first] % count, weights[first]
    half = sp.csr_matrix((w, (i, j)), shape=(count, count))
    return (half + half.T).tocsr()

"""Figures whose limbs grow together with what they touch, as in TOPKIDS.

A scanner cannot tell a hand from the thigh that it lies on. Here a posed figure is replaced by the
union of its parts: one surface encloses what overlaps or nearly touches, so that the topology
changes from figure to figure.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ssm_pipeline.data_prep.synthetic.articulated import draw_build
from ssm_pipeline.data_prep.synthetic.articulated_body import rest_body
from ssm_pipeline.data_prep.synthetic.articulated_pose import draw_touching_pose
from ssm_pipeline.data_prep.synthetic.articulated_settings import ArticulatedSettings
from ssm_pipeline.data_prep.synthetic.articulated_skin import person, posed
from ssm_pipeline.data_prep.synthetic.remeshing import nearest_vertices, remeshed, renumbered
from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.geometry.surface import face_normals, vertex_normals
from ssm_pipeline.meshing.isosurface import isosurface
from ssm_pipeline.meshing.smooth_field import SmoothField
from ssm_pipeline.records import Mesh, StudyError

_CELL_MM = 8.0  # of the grid on which the union is found
_GROWTH_MM = 3.0  # outward: gaps up to twice as wide close
_COVERED = (0.01, 0.12)  # share of the skin that lies in another part; a hand has about 2 %
_ATTEMPTS = 100
# A difference of 1 between two unit normals counts as much as this distance. The two sides of a
# narrow gap have opposite normals, so that no vertex is assigned across it.
_NORMAL_MM = 40.0
_BODY, _POSE = 2, 3  # the purposes of the random draws, apart from those of `articulated`


@dataclass(frozen=True, eq=False)
class MergedFigure:
    """mesh: remeshed; to_reference (V,) int: for each vertex of it the vertex of `reference` that
    is the same point of the body."""

    mesh: Mesh
    to_reference: np.ndarray


@functools.cache
def reference(vertices: int) -> Mesh:
    """The body at rest, free of contact, with about `vertices` vertices."""
    return remeshed(Mesh(*rest_body(), "figure000-reference"), vertices)


def merged_figure(settings: ArticulatedSettings, index: int) -> MergedFigure:
    """Figure `index` of the set, from 1 on: the same whatever others are made.

    The persons take turns. Poses are drawn until 1 to 12 % of the skin lies in another part.

    Raises:
        StudyError: If none of 100 poses does.
    """
    number = index % settings.persons
    build = draw_build(np.random.default_rng([settings.seed, _BODY, number]), "near-isometric")
    at_rest, faces = person(build), rest_body()[1]
    generator = np.random.default_rng([settings.seed, _POSE, index])
    case_id = f"figure{index:03d}-person{number:02d}"
    for _ in range(_ATTEMPTS):
        surface = posed(at_rest, draw_touching_pose(generator))
        if _COVERED[0] <= covered_share(Mesh(surface, faces, case_id)) <= _COVERED[1]:
            break
    else:
        raise StudyError(
            f"figure {index}: in none of {_ATTEMPTS} poses the limbs touch the body enough. "
            f"Choose another seed than {settings.seed}."
        )
    count = round(settings.vertices * generator.uniform(0.9, 1.1))
    merged = union(Mesh(surface, faces, case_id))
    mesh = remeshed(renumbered(merged, generator), count)
    on_body = _same_side(mesh, surface, faces)
    to_reference = nearest_vertices(reference(settings.vertices), rest_body()[0])
    return MergedFigure(mesh, to_reference[on_body])


def covered_share(mesh: Mesh) -> float:
    """The share of the vertices that lie within another part of the solid, or touch it."""
    low, winding = _winding(mesh)
    outside = mesh.vertices + _CELL_MM * vertex_normals(mesh.vertices, mesh.faces)
    cell = np.round((outside - low) / _CELL_MM).astype(int)
    return float((winding[tuple(cell.T)] > 0).mean())


def union(mesh: Mesh) -> Mesh:
    """One surface around all that a closed surface winds around, grown by 3 mm."""
    low, winding = _winding(mesh)
    inside = winding > 0
    distance = np.full(winding.shape, 4 * _CELL_MM)
    # Exact distances are needed near the skin alone.
    near = np.zeros(winding.shape, dtype=bool)
    cell = np.round((mesh.vertices - low) / _CELL_MM).astype(int)
    reach = range(-2, 3)
    for step in [(a, b, c) for a in reach for b in reach for c in reach]:
        near[tuple((cell + step).T)] = True
    points = low + _CELL_MM * np.argwhere(near)
    distance[near] = closest_points(points, mesh.vertices, mesh.faces).distances
    signed = np.where(inside, distance, -distance) + _GROWTH_MM
    field = SmoothField(np.ascontiguousarray(signed.T), _CELL_MM, low, np.eye(3), level=0.0)
    return isosurface(field, mesh.case_id)


def _winding(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """The grid's corner (3,) mm, and (X, Y, Z) int: how often the surface winds around each point.

    Counted along each vertical line of the grid: a triangle that faces up closes what is below it,
    one that faces down opens it.
    """
    low = mesh.vertices.min(axis=0) - 3.1 * _CELL_MM
    shape = np.ceil((mesh.vertices.max(axis=0) - low) / _CELL_MM).astype(int) + 4
    corners = (mesh.vertices[mesh.faces] - low) / _CELL_MM
    upward = face_normals(mesh.vertices, mesh.faces)[:, 2] > 0
    corners[~upward] = corners[~upward][:, ::-1]  # counter-clockwise from above
    first = np.ceil(corners[:, :, :2].min(axis=1)).astype(int)
    width = int((np.floor(corners[:, :, :2].max(axis=1)).astype(int) - first).max()) + 1
    change = np.zeros((*shape[:2], shape[2] + 1), dtype=np.int64)
    for step in [(a, b) for a in range(width) for b in range(width)]:
        column = first + step
        to_corner = corners[:, :, :2] - column[:, None]
        # Twice the areas of the triangles that the line's point makes with the opposite edges.
        opposite = np.stack(
            [_cross(to_corner[:, (c + 1) % 3], to_corner[:, (c + 2) % 3]) for c in range(3)], axis=1
        )
        hit = (opposite > 0).all(axis=1)
        weights = opposite[hit] / opposite[hit].sum(axis=1, keepdims=True)
        height = np.ceil((weights * corners[hit][:, :, 2]).sum(axis=1)).astype(int)
        sign = np.where(upward[hit], -1, 1)
        np.add.at(change, (column[hit, 0], column[hit, 1], height), sign)
    # Summed from above: what a triangle changes, it changes for all points below it.
    return low, -change[:, :, ::-1].cumsum(axis=2)[:, :, ::-1][:, :, 1:]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _same_side(mesh: Mesh, surface: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V,) the vertex of the posed body nearest to each of the mesh, position and normal alike."""

    def with_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
        return np.hstack([vertices, _NORMAL_MM * vertex_normals(vertices, faces)])

    tree = cKDTree(with_normals(surface, faces))
    return np.asarray(tree.query(with_normals(mesh.vertices, mesh.faces))[1])

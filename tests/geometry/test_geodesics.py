from typing import Any

import igl
import numpy as np
import pytest
import trimesh

from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.geometry.geodesics import (
    bridges,
    geodesic_matrix,
    geodesics_between,
    geodesics_from,
    straight_line_graph,
)


@pytest.fixture(scope="module")
def sphere() -> Any:
    mesh = trimesh.creation.icosphere(3, radius=1)
    return np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64)


def grid(size: int) -> tuple[np.ndarray, np.ndarray]:
    """A flat square of unit cells, each cut along the same diagonal."""
    rows, columns = np.meshgrid(np.arange(size), np.arange(size), indexing="ij")
    vertices = np.stack([rows.ravel(), columns.ravel(), np.zeros(size**2)], axis=1).astype(float)
    corner = (np.arange(size - 1)[:, None] * size + np.arange(size - 1)).ravel()
    lower = np.stack([corner, corner + size, corner + size + 1], axis=1)
    upper = np.stack([corner, corner + size + 1, corner + 1], axis=1)
    return vertices, np.concatenate([lower, upper])


def test_sphere_matches_great_circles(sphere: Any) -> None:
    vertices, faces = sphere
    matrix = geodesic_matrix(vertices, faces)
    truth = np.arccos(np.clip(vertices @ vertices.T, -1, 1))
    np.fill_diagonal(truth, 0)
    off = ~np.eye(len(vertices), dtype=bool)
    relative = np.abs(matrix - truth)[off] / truth[off]
    # The polyhedron's own geodesics are 0.3 % short; the graph's paths up to 1 % long.
    assert relative.mean() < 0.005
    assert relative.max() < 0.03
    assert np.allclose(matrix, matrix.T, atol=1e-6)
    assert (np.diag(matrix) == 0).all()


@pytest.mark.parametrize("waist", [1.0, 0.3])
def test_never_shorter_than_the_exact_geodesic(sphere: Any, waist: float) -> None:
    # With a waist the surface has saddles: a line that leaves its strip would be too short there.
    vertices, faces = sphere
    waisted = waist + (1 - waist) * vertices[:, 1:2] ** 2
    stretched = vertices * np.concatenate([waisted, 2 * np.ones_like(waisted), 0.6 * waisted], 1)
    none = np.zeros(0, dtype=np.int64)
    everywhere = np.arange(len(vertices))
    for source in (0, 77, 400):
        exact = igl.exact_geodesic(stretched, faces, np.array([source]), none, everywhere, none)
        found = geodesics_from(stretched, faces, np.array([source]))[0]
        assert (found - exact).min() > -1e-9
        assert ((found - exact) / np.maximum(exact, 1e-9))[
            exact > 0
        ].mean() < 0.015  # long thin triangles


def test_flat_neighbours_are_exact_and_far_points_close() -> None:
    vertices, faces = grid(15)
    centre = 7 * 15 + 7
    truth = np.linalg.norm(vertices - vertices[centre], axis=1)
    found = geodesics_from(vertices, faces, np.array([centre]))[0]
    near = truth < 2.1  # all seen straight within five triangles
    assert np.abs(found - truth)[near].max() < 1e-12
    assert (np.abs(found - truth)[~near] / truth[~near]).max() < 0.03


def test_more_strips_see_more_vertices(sphere: Any) -> None:
    vertices, faces = sphere
    degrees = [straight_line_graph(vertices, faces, strips).nnz for strips in (0, 2, 4)]
    assert degrees[0] == 2 * len(
        np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)), axis=0)
    )
    assert degrees[0] < degrees[1] < degrees[2]


def test_does_not_depend_on_pose_or_numbering(sphere: Any) -> None:
    vertices, faces = sphere
    stretched = vertices * [1.0, 2.0, 0.4]
    generator = np.random.default_rng(0)
    rotation = np.linalg.qr(generator.normal(size=(3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    order = generator.permutation(len(vertices))
    position = np.argsort(order)
    renumbered = np.roll(position[faces], 1, axis=1)[generator.permutation(len(faces))]
    before = geodesics_from(stretched, faces, order[:5])
    after = geodesics_from((stretched @ rotation.T + 40)[order], renumbered, np.arange(5))
    # Windows that graze a vertex may be kept or not by round-off; paths change by a hair then.
    assert np.abs(after - before[:, order]).max() < 0.01


def test_other_component_and_limit(sphere: Any) -> None:
    vertices, faces = sphere
    two = np.concatenate([vertices, vertices + 10]), np.concatenate([faces, faces + len(vertices)])
    found = geodesics_from(*two, np.array([0]))[0]
    assert np.isfinite(found[: len(vertices)]).all()
    assert np.isinf(found[len(vertices) :]).all()
    limited = geodesics_from(vertices, faces, np.array([0]), limit=1.0)[0]
    assert limited[np.isfinite(limited)].max() <= 1.0
    assert np.isinf(limited).any()


def test_between_points_inside_triangles(sphere: Any) -> None:
    vertices, faces = sphere
    generator = np.random.default_rng(1)
    directions = generator.normal(size=(2, 400, 3))
    directions[1, :200] = directions[0, :200] + 0.05 * generator.normal(size=(200, 3))  # near
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    start, end = (closest_points(points, vertices, faces) for points in directions)
    truth = np.arccos(np.clip(np.einsum("qd,qd->q", *directions), -1, 1))
    found = geodesics_between(vertices, faces, start, end)
    assert (np.abs(found - truth) / truth)[200:].mean() < 0.01
    # Near pairs lie within an edge (0.14) of each other: no bias of an edge's length.
    assert np.abs(found - truth)[:200].mean() < 0.002
    assert geodesics_between(vertices, faces, start, start).max() == 0


def test_between_components_is_infinite(sphere: Any) -> None:
    vertices, faces = sphere
    two = np.concatenate([vertices, vertices + 10]), np.concatenate([faces, faces + len(vertices)])
    start = closest_points(np.array([[0.0, 0, 1], [0, 1, 0]]), *two)
    end = closest_points(np.array([[10.0, 10, 11], [0, 0, 1]]), *two)
    found = geodesics_between(*two, start, end)
    assert np.isinf(found[0])
    assert found[1] == pytest.approx(np.pi / 2, rel=0.02)


def test_pieces_and_loose_vertices_are_reached_straight_across_the_gap() -> None:
    """Two balls, a vertex no triangle uses, and one in the same place as another."""
    ball = trimesh.creation.icosphere(2)
    small = trimesh.creation.icosphere(0)
    loose = np.array([[0.0, 0, 1.5], ball.vertices[7]])
    vertices = np.concatenate([ball.vertices, small.vertices * 0.1 + [1.3, 0, 0], loose])
    faces = np.concatenate([ball.faces, small.faces + len(ball.vertices)])
    pairs = bridges(vertices, faces)
    assert len(pairs) == 3  # a piece and two vertices
    assert np.isinf(geodesic_matrix(vertices, faces)).any()
    matrix = geodesic_matrix(vertices, faces, across_gaps=True)
    assert np.isfinite(matrix).all()
    assert matrix == pytest.approx(matrix.T)
    own = slice(0, len(ball.vertices))
    assert matrix[own, own] == pytest.approx(geodesic_matrix(ball.vertices, ball.faces))
    assert matrix[-1, 7] == pytest.approx(0, abs=1e-9)
    gap = np.linalg.norm(ball.vertices - loose[0], axis=1)
    assert matrix[-2, gap.argmin()] == pytest.approx(gap.min(), rel=1e-6)
    # To the small ball's far side: the gap, then half way round it.
    assert 0.2 < matrix[len(ball.vertices) : -2, own].max(axis=0).min() < 0.6
    assert len(bridges(np.asarray(ball.vertices), np.asarray(ball.faces))) == 0

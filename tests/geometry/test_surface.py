"""Known answers on boxes and balls, and what a surface's measures must not depend on."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from shapes import blob, sphere

from ssm_pipeline.geometry.barycentric import interpolated
from ssm_pipeline.geometry.surface import (
    area,
    centroid,
    face_areas,
    face_normals,
    sample_points,
    sample_surface,
    vertex_normals,
    volume,
)

BOX = trimesh.creation.box([2.0, 3.0, 5.0])
VERTICES, FACES = np.array(BOX.vertices), np.array(BOX.faces)


def test_a_box_has_its_area_volume_and_centre() -> None:
    assert area(VERTICES, FACES) == pytest.approx(2 * (2 * 3 + 3 * 5 + 5 * 2))
    assert face_areas(VERTICES, FACES).sum() == pytest.approx(62)
    assert volume(VERTICES + np.array([100, -50, 7]), FACES) == pytest.approx(30)
    assert volume(VERTICES, FACES[:, ::-1]) == pytest.approx(-30)
    np.testing.assert_allclose(centroid(VERTICES + np.array([1, 2, 3]), FACES), [1, 2, 3])


def test_the_centroid_does_not_move_with_the_triangulation() -> None:
    ball = sphere(10.0)
    above = np.flatnonzero(ball.vertices[ball.faces].mean(axis=1)[:, 2] > 0)
    finer_vertices, finer = trimesh.remesh.subdivide(ball.vertices, ball.faces, above)
    assert np.abs(finer_vertices.mean(axis=0)[2]) > 1  # as the mean of the vertices does
    np.testing.assert_allclose(
        centroid(finer_vertices, finer), centroid(ball.vertices, ball.faces), atol=1e-12
    )


def test_normals_are_unit_and_look_outward() -> None:
    ball = sphere(10.0, subdivisions=4)
    centres = ball.vertices[ball.faces].mean(axis=1)
    for normals, points in (
        (face_normals(ball.vertices, ball.faces), centres),
        (vertex_normals(ball.vertices, ball.faces), ball.vertices),
    ):
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
        outward = points / np.linalg.norm(points, axis=1, keepdims=True)
        # A normal leans by at most about half an edge over the radius, 0.04.
        assert np.linalg.norm(normals - outward, axis=1).max() < 0.04


def test_normals_turn_with_the_surface() -> None:
    turn = Rotation.from_rotvec([0.3, -0.4, 1.1]).as_matrix()
    for normals in (face_normals, vertex_normals):
        turned = normals(7 * VERTICES @ turn.T + 5, FACES)
        np.testing.assert_allclose(turned, normals(VERTICES, FACES) @ turn.T, atol=1e-12)


def test_what_has_no_area_has_no_normal() -> None:
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [5, 5, 5]])
    assert not face_normals(flat, np.array([[0, 1, 2]])).any()
    assert not vertex_normals(flat, np.array([[0, 1, 2]])).any()


def test_samples_lie_on_the_surface_in_proportion_to_area() -> None:
    generator = np.random.default_rng(0)
    face, weights = sample_surface(VERTICES, FACES, 6200, generator)
    np.testing.assert_allclose(weights.sum(axis=1), 1)
    assert weights.min() >= 0
    # One draw a strip of 0.01: no triangle has a sample more or less than its share.
    share = np.bincount(face, minlength=len(FACES)) - 100 * face_areas(VERTICES, FACES)
    assert np.abs(share).max() <= 2
    points = interpolated(VERTICES, FACES[face], weights)
    assert np.isclose(np.abs(points / [1.0, 1.5, 2.5]).max(axis=1), 1).all()
    # Even within each triangle too: the mean of its samples is its centre.
    for index in range(len(FACES)):
        centre = VERTICES[FACES[index]].mean(axis=0)
        assert np.linalg.norm(points[face == index].mean(axis=0) - centre) < 0.25


def test_samples_depend_on_the_generator_alone() -> None:
    mesh = blob(0)
    first, again, other = (
        sample_points(mesh.vertices, mesh.faces, 50, np.random.default_rng(seed))
        for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 1


def test_interpolation_is_linear_and_takes_stacks() -> None:
    generator = np.random.default_rng(0)
    values = generator.standard_normal((4, 5, 8, 2))
    corners, weights = generator.integers(0, 8, (6, 3)), generator.dirichlet(np.ones(3), 6)
    found = interpolated(values, corners, weights)
    assert found.shape == (4, 5, 6, 2)
    by_hand = sum(weights[2, c] * values[3, 1, corners[2, c]] for c in range(3))
    np.testing.assert_allclose(found[3, 1, 2], by_hand)
    np.testing.assert_allclose(interpolated(values + 1, corners, weights), found + 1)

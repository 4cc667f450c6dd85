"""Alignment finds the motion that was applied, and the best one where none fits."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation
from shapes import blob

from ssm_pipeline.geometry.rigid import best_similarity, iterative_closest_point
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.geometry.surface import sample_points

TURN = Rotation.from_rotvec([0.2, -0.5, 0.3]).as_matrix()
MOTION = Similarity(1.0, TURN, np.array([30.0, -20.0, 5.0]))


def points(count: int = 40) -> np.ndarray:
    return np.random.default_rng(0).standard_normal((count, 3)) * [10, 20, 40]


def test_a_motion_is_found_exactly_and_undone_by_its_inverse() -> None:
    found = best_similarity(points(), MOTION.apply(points()))
    np.testing.assert_allclose(found.rotation, MOTION.rotation, atol=1e-12)
    np.testing.assert_allclose(found.translation, MOTION.translation, atol=1e-10)
    np.testing.assert_allclose(found.inverse().apply(MOTION.apply(points())), points(), atol=1e-10)


def test_scale_is_found_if_asked_for() -> None:
    larger = Similarity(1.7, TURN, np.array([1.0, 2.0, 3.0]))
    found = best_similarity(points(), larger.apply(points()), with_scale=True)
    assert found.scale == pytest.approx(1.7)
    np.testing.assert_allclose(found.inverse().apply(larger.apply(points())), points(), atol=1e-10)
    assert best_similarity(points(), larger.apply(points())).scale == 1


def test_a_mirror_image_is_not_turned_inside_out() -> None:
    found = best_similarity(points(), points() * [-1, 1, 1])
    assert np.linalg.det(found.rotation) == pytest.approx(1)


def test_no_small_turn_does_better_where_nothing_fits_exactly() -> None:
    generator = np.random.default_rng(1)
    target = MOTION.apply(points()) + 5 * generator.standard_normal((40, 3))
    weights = generator.random(40)
    found = best_similarity(points(), target, weights)

    def misfit(change: np.ndarray) -> float:
        turn = Rotation.from_rotvec(change[:3]).as_matrix() @ found.rotation
        moved = points() @ turn.T + found.translation + change[3:]
        return float(weights @ ((moved - target) ** 2).sum(axis=1))

    better = minimize(misfit, np.zeros(6))
    assert better.fun == pytest.approx(misfit(np.zeros(6)), rel=1e-9)


def test_points_without_weight_do_not_count() -> None:
    target = MOTION.apply(points())
    target[:10] += 1000
    weights = np.r_[np.zeros(10), np.ones(30)]
    np.testing.assert_allclose(
        best_similarity(points(), target, weights).rotation, MOTION.rotation, atol=1e-12
    )


def test_surfaces_are_laid_on_each_other_without_correspondence() -> None:
    mesh = blob(0)
    source, target = (
        sample_points(mesh.vertices, mesh.faces, 4000, np.random.default_rng(seed))
        for seed in (0, 1)
    )
    found = iterative_closest_point(source, MOTION.apply(target), steps=300)
    # Two samplings of one surface lie 2 mm apart a point; their best motion differs far less.
    error = found.apply(mesh.vertices) - MOTION.apply(mesh.vertices)
    assert np.linalg.norm(error, axis=1).max() < 0.5


def test_a_frame_that_does_nothing() -> None:
    np.testing.assert_array_equal(Similarity.identity().apply(points()), points())

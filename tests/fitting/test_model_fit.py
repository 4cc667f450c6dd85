from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from cohorts import TURN, bumpy_cohort, finer

from ssm_pipeline.fitting.matched_fit import fit_points
from ssm_pipeline.fitting.model_fit import _Problem, fit_model
from ssm_pipeline.fitting.partial import without_faces
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records import CaseError, Mesh
from ssm_pipeline.shape_model.alignment import align
from ssm_pipeline.shape_model.pca import pca_model

TRUTH = [1.2, -0.8, 0.5]


@pytest.fixture(scope="module")
def model() -> Any:
    return pca_model(align(bumpy_cohort(12))[0])


def test_an_instance_is_found_again_wherever_it_lies(model: Any) -> None:
    points = TURN.apply(model.reconstruct(TRUTH))
    found = fit_model(model, finer(Mesh(points, model.faces, "new")))
    assert found.distances_mm.mean() < 0.05
    assert found.observed.all()
    # Three modes of 12 cases hold all there is; the others' standard deviations are below 0.1 mm.
    np.testing.assert_allclose(found.scores[:3], TRUTH, atol=0.1)
    np.testing.assert_allclose(found.frame.rotation, TURN.rotation, atol=0.01)
    np.testing.assert_allclose(
        found.frame.apply(model.reconstruct(found.scores)), found.vertices, atol=1e-9
    )


def test_size_is_found_where_the_pose_has_one(model: Any) -> None:
    pose = Similarity(1.2, TURN.rotation, TURN.translation)
    surface = Mesh(pose.apply(model.reconstruct(TRUTH)), model.faces, "large")
    assert fit_model(model, surface, with_scale=True).frame.scale == pytest.approx(1.2, rel=0.01)
    assert fit_model(model, surface).frame.scale == 1.0


def test_scores_lie_within_their_stated_errors_when_the_surface_is_rough(model: Any) -> None:
    """Over many surfaces with a smooth error that no mode makes, the scores' errors are about as
    large as the posterior says: the points' number alone would say ten times less."""
    generator = np.random.default_rng(5)
    z = []
    for _ in range(8):
        scores = generator.standard_normal(3)
        points = model.reconstruct(scores)
        wave = np.sin(points @ (0.08 * generator.standard_normal(3)) + 6 * generator.random())
        rough = points + 1.5 * wave[:, None] * points / np.linalg.norm(points, axis=1)[:, None]
        found = fit_model(model.truncate(3), Mesh(rough, model.faces, "rough"), points=400)
        z.append((found.scores - scores) / found.score_sd)
    # The median of |z| is 0.67 for a normal distribution, known to 20 % from 24 numbers; a wave is
    # no white noise, and a long one looks like a mode: hence a factor, and the median.
    assert 0.3 < np.median(np.abs(z)) < 1.6


def test_what_was_cut_off_is_not_held_against_the_model(model: Any) -> None:
    whole = finer(Mesh(TURN.apply(model.reconstruct(TRUTH)), model.faces, "cut"))
    height = whole.vertices[:, 2]
    top = height > height.max() - np.ptp(height) / 3
    part = without_faces(whole, top[whole.faces].any(axis=1))
    found = fit_model(model, part, start=TURN)
    assert 0.15 < 1 - found.observed.mean() < 0.45
    np.testing.assert_allclose(found.scores[:3], TRUTH, atol=0.3)
    # The same surface closed by a flat lid is taken for an organ that ends there.
    assert found.score_sd[0] > fit_model(model, whole, start=TURN).score_sd[0]
    error = np.linalg.norm(found.vertices - TURN.apply(model.reconstruct(TRUTH)), axis=1)
    assert error[~found.observed].mean() < 1.0


def test_matched_points_give_the_same_scores_at_once(model: Any) -> None:
    points = TURN.apply(model.reconstruct(TRUTH))
    found = fit_points(model, points, Mesh(points, model.faces, "new"))
    np.testing.assert_allclose(found.scores[:3], TRUTH, atol=1e-3)
    np.testing.assert_allclose(found.vertices, points, atol=1e-2)


def test_a_matched_case_with_noise_is_drawn_towards_the_mean(model: Any) -> None:
    generator = np.random.default_rng(0)
    exact = model.reconstruct([2.0, 0.0, 0.0])
    noisy = exact + 5.0 * generator.standard_normal(exact.shape)
    found = fit_points(model, noisy, Mesh(noisy, model.faces, "noisy"))
    # Per coordinate: what three rigid and shape modes take out of 900 numbers is little.
    assert found.noise_mm == pytest.approx(5.0, rel=0.1)
    assert found.mahalanobis < np.linalg.norm(model.coefficients(noisy))


def test_a_surface_that_looks_inward_is_refused_by_name() -> None:
    shapes = bumpy_cohort(6)
    model = pca_model(align(shapes)[0])
    inward = Mesh(model.mean, model.faces[:, ::-1], "rev")
    with pytest.raises(CaseError, match=r"case rev: no point of the model faces the surface"):
        fit_model(model, inward)


def test_points_of_the_model_beyond_a_cut_are_not_compared(model: Any) -> None:
    """The nearest point of the cut's border is not where they should be."""
    whole = finer(Mesh(model.mean, model.faces, "cut"))
    half = whole.vertices[:, 2] > whole.vertices[:, 2].mean()
    part = without_faces(whole, half[whole.faces].any(axis=1))
    problem = _Problem(model, part, False, 400, np.random.default_rng(0))
    pairs = problem.pairs(Similarity.identity(), np.zeros(model.mode_count))
    assert 0.3 < pairs.observed_share < 0.7
    assert pairs.of_model == round(400 * pairs.observed_share)
    edge = whole.vertices[half].min(axis=0)[2]
    assert pairs.at[: pairs.of_model, 2].max() < edge + 1e-6
    assert np.abs(pairs.residuals[: pairs.of_model]).max() < 1e-6

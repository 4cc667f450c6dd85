"""Marginal, posterior and transform of a model, against the formulas of the normal distribution."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import multivariate_normal
from sklearn.decomposition import PCA

from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records import CorrespondedShapes
from ssm_pipeline.shape_model.model import ShapeModel
from ssm_pipeline.shape_model.pca import pca_model

FACES = np.array([[0, 1, 2], [1, 3, 2], [2, 3, 4], [4, 5, 0]])
SEEN = np.array([4, 0, 2])


def small_model(cases: int = 9) -> ShapeModel:
    points = np.random.default_rng(3).standard_normal((cases, 6, 3)) * [3.0, 2.0, 1.0]
    ids = tuple(f"c{index}" for index in range(cases))
    return pca_model(CorrespondedShapes(points, FACES, ids, "c0"))


def covariance(model: ShapeModel) -> np.ndarray:
    """(3V, 3V) mm²."""
    Q = (model.standard_deviations[:, None, None] * model.modes).reshape(model.mode_count, -1)
    product: np.ndarray = Q.T @ Q
    return product


def coordinates_of(vertices: np.ndarray) -> np.ndarray:
    return (3 * vertices[:, None] + np.arange(3)).ravel()


def test_the_posterior_is_the_conditional_normal_distribution() -> None:
    model, noise = small_model(), 0.7
    points = model.mean[SEEN] + np.random.default_rng(1).standard_normal((3, 3))
    C, seen = covariance(model), coordinates_of(SEEN)
    gain = C[:, seen] @ np.linalg.inv(C[np.ix_(seen, seen)] + noise**2 * np.eye(9))
    expected = model.mean.ravel() + gain @ (points - model.mean[SEEN]).ravel()

    posterior = model.posterior(SEEN, points, noise)

    np.testing.assert_allclose(posterior.mean.ravel(), expected, atol=1e-10)
    np.testing.assert_allclose(covariance(posterior), C - gain @ C[seen], atol=1e-10)
    flat = posterior.modes.reshape(posterior.mode_count, -1)
    np.testing.assert_allclose(flat @ flat.T, np.eye(len(flat)), atol=1e-12)
    assert np.all(np.diff(posterior.variances) <= 0)
    blocks = [covariance(posterior)[3 * v : 3 * v + 3, 3 * v : 3 * v + 3] for v in range(6)]
    np.testing.assert_allclose(posterior.vertex_covariances, blocks, atol=1e-10)


def test_a_posterior_is_sharp_without_noise_and_the_model_itself_with_much() -> None:
    model = small_model()
    points = model.reconstruct([0.5, -1.0, 0.3])[SEEN]
    sharp, blind = model.posterior(SEEN, points, 1e-4), model.posterior(SEEN, points, 1e6)
    np.testing.assert_allclose(sharp.mean[SEEN], points, atol=1e-5)
    np.testing.assert_allclose(blind.mean, model.mean, atol=1e-6)
    np.testing.assert_allclose(blind.variances, model.variances, rtol=1e-6)


def test_all_points_with_noise_give_the_scores_of_probabilistic_pca() -> None:
    """Tipping and Bishop 1999: E[b] = (λ/(λ + σ²)) times the projection, mode by mode."""
    model, noise = small_model(), 0.9
    points = np.random.default_rng(2).standard_normal((6, 3))
    posterior = model.posterior(np.arange(6), points, noise)
    shrunk = model.variances / (model.variances + noise**2) * model.coefficients(points)
    np.testing.assert_allclose(model.coefficients(posterior.mean), shrunk, atol=1e-10)
    expected = np.sort(model.variances * noise**2 / (model.variances + noise**2))[::-1]
    np.testing.assert_allclose(posterior.variances, expected, atol=1e-10)


def test_modes_are_those_of_scikit_learn() -> None:
    points = np.random.default_rng(5).standard_normal((9, 6, 3))
    model = pca_model(CorrespondedShapes(points, FACES, tuple("abcdefghi"), "a"))
    other = PCA(8).fit(points.reshape(9, -1))
    np.testing.assert_allclose(model.variances, other.explained_variance_)
    flat = model.modes.reshape(8, -1)
    np.testing.assert_allclose(np.abs(flat @ other.components_.T), np.eye(8), atol=1e-7)
    scores = other.transform(points.reshape(9, -1)) / np.sqrt(other.explained_variance_)
    np.testing.assert_allclose(np.abs(model.coefficients(points)), np.abs(scores), atol=1e-7)


def test_the_marginal_keeps_the_covariance_of_its_vertices() -> None:
    model = small_model()
    part = model.marginal(SEEN)
    seen = coordinates_of(SEEN)
    np.testing.assert_allclose(covariance(part), covariance(model)[np.ix_(seen, seen)], atol=1e-10)
    np.testing.assert_allclose(
        part.reconstruct(part.scores), model.reconstruct(model.scores)[:, SEEN], atol=1e-10
    )
    # Of the four faces none has all its corners among 4, 0 and 2.
    assert part.faces.shape == (0, 3)
    np.testing.assert_array_equal(model.marginal(np.array([3, 2, 1])).faces, [[2, 0, 1]])


def test_a_marginal_of_the_posterior_is_the_posterior_of_the_marginal() -> None:
    model, points = small_model(), np.zeros((3, 3))
    one = model.posterior(SEEN, points, 0.5).marginal(SEEN)
    other = model.marginal(SEEN).posterior(np.arange(3), points, 0.5)
    np.testing.assert_allclose(one.mean, other.mean, atol=1e-10)
    np.testing.assert_allclose(covariance(one), covariance(other), atol=1e-10)


def test_a_transformed_model_makes_the_transformed_shapes() -> None:
    model = small_model()
    turn = Rotation.from_euler("xyz", [20, -50, 70], degrees=True).as_matrix()
    frame = Similarity(1.4, turn, np.array([5.0, -3.0, 100.0]))
    moved = model.transform(frame)
    scores = np.random.default_rng(4).standard_normal((5, model.mode_count))
    np.testing.assert_allclose(
        moved.reconstruct(scores), frame.apply(model.reconstruct(scores)), atol=1e-10
    )
    other = model.mean + np.arange(6)[:, None]
    np.testing.assert_allclose(
        moved.coefficients(frame.apply(other)), model.coefficients(other), atol=1e-10
    )


def test_projecting_twice_changes_nothing_and_leaves_what_no_mode_can_make() -> None:
    model = small_model()
    points = np.random.default_rng(6).standard_normal((6, 3))
    nearest = model.project(points)
    np.testing.assert_allclose(model.project(nearest), nearest, atol=1e-12)
    rest = (points - nearest).ravel()
    np.testing.assert_allclose(model.modes.reshape(model.mode_count, -1) @ rest, 0, atol=1e-12)


def test_log_pdf_is_that_of_independent_standard_normals() -> None:
    model = small_model()
    scores = np.random.default_rng(7).standard_normal((4, model.mode_count))
    expected = multivariate_normal(np.zeros(model.mode_count)).logpdf(scores)
    np.testing.assert_allclose(model.log_pdf(scores), expected)


def test_a_model_cannot_be_changed_and_does_not_follow_what_it_was_made_of() -> None:
    model = small_model()
    for array in (model.mean, model.modes, model.variances, model.faces, model.scores):
        with pytest.raises(ValueError, match="read-only"):
            array[:] = 0
    mean = np.zeros((6, 3))
    made = ShapeModel(mean, model.modes, model.variances, FACES, model.scores, model.case_ids)
    mean += 1
    assert not made.mean.any()
    assert (model == model) is True  # no comparison of arrays, which would raise
    assert (model == small_model()) is False


def test_wrong_observations_are_refused() -> None:
    model = small_model()
    with pytest.raises(ValueError, match=r"points have shape \(2, 3\) for 3 vertices"):
        model.posterior(SEEN, np.zeros((2, 3)), 1.0)
    with pytest.raises(ValueError, match="noise_mm is 0"):
        model.posterior(SEEN, np.zeros((3, 3)), 0)
    with pytest.raises(ValueError, match="2 scores given; the model has 8"):
        model.log_pdf(np.zeros(2))
    with pytest.raises(ValueError, match=r"scores have shape \(9, 8\) for 1 cases"):
        ShapeModel(model.mean, model.modes, model.variances, FACES, model.scores, ("a",))

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from shapes import blob

from ssm_pipeline.records import CorrespondedShapes, StudyError
from ssm_pipeline.shape_model.alignment import align
from ssm_pipeline.shape_model.pca import pca_model


def hand_made(count: Any = 40, seed: int = 0) -> Any:
    """A mean and two known orthonormal modes with known scores."""
    mesh = blob(1, faces=200)
    generator = np.random.default_rng(seed)
    flat = np.linalg.qr(generator.standard_normal((mesh.vertices.size, 2)))[0].T
    scores = generator.standard_normal((count, 2))
    scores -= scores.mean(axis=0)
    scores = np.linalg.qr(scores)[0] * np.sqrt(count - 1)  # exactly uncorrelated, variance 1
    data = mesh.vertices.ravel() + scores * [9.0, 4.0] @ flat
    shapes = CorrespondedShapes(
        data.reshape(count, -1, 3), mesh.faces, tuple(f"c{i}" for i in range(count)), "c0"
    )
    return shapes, mesh.vertices, flat.reshape(2, -1, 3), scores


def test_pca_finds_a_hand_made_model() -> None:
    shapes, mean, modes, scores = hand_made()
    model = pca_model(shapes)
    assert model.mode_count == 2
    np.testing.assert_allclose(model.variances, [81.0, 16.0])
    np.testing.assert_allclose(model.mean, mean, atol=1e-9)
    for m in range(2):
        sign = np.sign((model.modes[m] * modes[m]).sum())
        np.testing.assert_allclose(sign * model.modes[m], modes[m], atol=1e-9)
        np.testing.assert_allclose(sign * model.scores[:, m], scores[:, m], atol=1e-9)
    np.testing.assert_allclose(model.compactness, [81 / 97, 1.0])
    assert (model.modes_for(0.8), model.modes_for(0.9)) == (1, 2)


def test_all_modes_reconstruct_every_case() -> None:
    generator = np.random.default_rng(1)
    points = generator.standard_normal((6, 30, 3))
    shapes = CorrespondedShapes(points, np.zeros((0, 3), int), tuple("abcdef"), "a")
    model = pca_model(shapes)
    assert model.mode_count == 5
    np.testing.assert_allclose(model.reconstruct(model.scores), points, atol=1e-9)
    np.testing.assert_allclose(model.coefficients(points), model.scores, atol=1e-9)
    flat = model.modes.reshape(5, -1)
    np.testing.assert_allclose(flat @ flat.T, np.eye(5), atol=1e-12)
    assert np.all(np.diff(model.variances) <= 0)


def test_variances_are_those_of_the_covariance() -> None:
    points = np.random.default_rng(2).standard_normal((7, 4, 3))
    shapes = CorrespondedShapes(points, np.zeros((0, 3), int), tuple("abcdefg"), "a")
    values = np.linalg.eigvalsh(np.cov(points.reshape(7, -1).T))[::-1]
    np.testing.assert_allclose(pca_model(shapes).variances, values[:6])


def test_of_more_cases_than_coordinates_the_model_is_the_same() -> None:
    points = np.random.default_rng(3).standard_normal((2500, 4, 3)) * np.arange(1, 5)[:, None]
    points[:, 3] = points[:, 0] + points[:, 1]  # three coordinates that vary with others
    ids = tuple(f"case_{number}" for number in range(len(points)))
    model = pca_model(CorrespondedShapes(points, np.zeros((0, 3), int), ids, ids[0]))
    flat = points.reshape(len(points), -1)
    _, singular, Vt = np.linalg.svd(flat - flat.mean(axis=0), full_matrices=False)
    assert model.mode_count == 9
    np.testing.assert_allclose(model.variances, singular[:9] ** 2 / 2499)
    overlap = (model.modes.reshape(9, -1) * Vt[:9]).sum(axis=1)
    np.testing.assert_allclose(np.abs(overlap), 1, atol=1e-9)
    np.testing.assert_allclose(model.reconstruct(model.scores), points, atol=1e-9)


def test_samples_have_the_models_variance() -> None:
    model = pca_model(hand_made()[0])
    draws = model.coefficients(model.sample(4000, np.random.default_rng(0)))
    # Standard error of a variance of 4000 draws: √(2/4000) = 2.2 %; four of them allowed.
    np.testing.assert_allclose(draws.var(axis=0), 1, atol=0.09)
    np.testing.assert_allclose(model.truncate(1).reconstruct([2.0]), model.reconstruct([2.0, 0]))


def test_bad_sizes_say_what_was_needed() -> None:
    model = pca_model(hand_made()[0])
    with pytest.raises(ValueError, match="3 scores given; the model has 2 modes"):
        model.reconstruct([1, 2, 3])
    with pytest.raises(ValueError, match="in correspondence with the model's mean"):
        model.coefficients(np.zeros((5, 3)))
    with pytest.raises(ValueError, match="3 modes requested; the model has 2"):
        model.truncate(3)
    shapes = hand_made()[0]
    two = CorrespondedShapes(shapes.vertices[:2], shapes.faces, ("c0", "c1"), "c0")
    with pytest.raises(StudyError, match="at least 3 usable cases; 2 found"):
        pca_model(two)


@pytest.mark.parametrize("with_scale", [False, True])
def test_alignment_undoes_any_pose(with_scale: bool) -> None:
    mesh = blob(1, faces=200)
    generator = np.random.default_rng(0)
    moved = []
    for turn in Rotation.random(5, random_state=1).as_matrix():
        scale = generator.uniform(0.7, 1.4) if with_scale else 1.0
        moved.append(scale * mesh.vertices @ turn.T + 50 * generator.standard_normal(3))
    shapes = CorrespondedShapes(np.stack(moved), mesh.faces, tuple("abcde"), "a")
    aligned, frames = align(shapes, with_scale)
    np.testing.assert_allclose(aligned.vertices, aligned.vertices[:1].repeat(5, 0), atol=1e-6)
    np.testing.assert_allclose(frames[3].apply(moved[3]), aligned.vertices[3], atol=1e-9)
    if not with_scale:
        # Up stays up: the result is the template itself, centred.
        np.testing.assert_allclose(aligned.vertices[0], moved[0] - moved[0].mean(0), atol=1e-6)


def test_a_model_without_size_is_the_same_whichever_case_is_the_template() -> None:
    generator = np.random.default_rng(0)
    sizes = np.linspace(0.7, 1.4, 6)[:, None, None]
    cases = sizes * (blob(1, faces=200).vertices + generator.normal(0, 0.5, (6, 102, 3)))
    spread = []
    for template in ("a", "f"):
        shapes = CorrespondedShapes(cases, blob(1, faces=200).faces, tuple("abcdef"), template)
        aligned, _ = align(shapes, with_scale=True)
        spread.append(pca_model(aligned).variances.sum())
        means = aligned.vertices.mean(axis=0)
        size = np.linalg.norm(cases - cases.mean(axis=1, keepdims=True), axis=(1, 2)).mean()
        assert np.linalg.norm(means - means.mean(axis=0)) == pytest.approx(size, rel=1e-3)
    assert spread[0] == pytest.approx(spread[1], rel=1e-6)


def test_alignment_keeps_what_is_not_pose() -> None:
    shapes, *_ = hand_made()
    aligned, _ = align(shapes)
    assert pca_model(aligned).variances[0] > 30


def test_equal_shapes_have_no_modes_and_it_says_so() -> None:
    sphere = np.random.default_rng(0).standard_normal((50, 3))
    faces = np.array([[0, 1, 2]])
    names = ("a", "b", "c", "d")
    with pytest.raises(StudyError, match="all 4 shapes are equal"):
        pca_model(CorrespondedShapes(np.stack([sphere] * 4), faces, names, "a"))

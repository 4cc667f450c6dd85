from typing import Any

import numpy as np
import pytest
from synthetic_shapes import sphere

from ssm_pipeline.evaluation.matching_quality import (
    area_under_curve,
    conformal_distortion,
    geodesic_errors,
    pck_curve,
)
from ssm_pipeline.geometry.geodesics import geodesic_matrix
from ssm_pipeline.geometry.surface import area


@pytest.fixture(scope="module")
def unit_sphere() -> Any:
    vertices, faces = sphere(3)
    return vertices, faces, geodesic_matrix(vertices, faces)


def test_identity_has_no_error(unit_sphere: Any) -> None:
    vertices, faces, distances = unit_sphere
    truth = np.arange(len(vertices))
    errors = geodesic_errors(truth, truth, distances, area(vertices, faces))
    assert errors.max() == 0
    assert area_under_curve(errors) == pytest.approx(1)
    assert pck_curve(errors)["share"].eq(1).all()


def test_random_map_scores_as_chance(unit_sphere: Any) -> None:
    # Two random points on the unit sphere: mean distance π/2, over √(4π) 0.443; a cap of angle θ
    # holds (1 − cos θ)/2 of the sphere.
    vertices, faces, distances = unit_sphere
    generator = np.random.default_rng(0)
    predicted, truth = generator.integers(len(vertices), size=(2, 20_000))
    errors = geodesic_errors(predicted, truth, distances, area(vertices, faces))
    assert errors.mean() == pytest.approx(np.pi / 2 / np.sqrt(4 * np.pi), rel=0.02)
    limit = 0.5
    thresholds = np.linspace(0, limit, 1001)
    chance = (1 - np.cos(thresholds * np.sqrt(4 * np.pi))) / 2
    assert area_under_curve(errors, limit) == pytest.approx(chance.mean(), rel=0.05)
    curve = pck_curve(errors, limit)
    expected = (1 - np.cos(curve["threshold"] * np.sqrt(4 * np.pi))) / 2
    # Vertices are 0.15 apart: the curve climbs in steps of that size at its start.
    assert np.abs(curve["share"] - expected).max() < 0.05


def test_errors_do_not_depend_on_size(unit_sphere: Any) -> None:
    vertices, faces, distances = unit_sphere
    predicted, truth = np.random.default_rng(0).integers(len(vertices), size=(2, 50))
    small = geodesic_errors(predicted, truth, distances, area(vertices, faces))
    large = geodesic_errors(predicted, truth, 80 * distances, area(80 * vertices, faces))
    assert small == pytest.approx(large, rel=1e-6)


def test_curve_of_known_errors() -> None:
    errors = np.array([0.0, 0.02, 0.05, 0.2])
    curve = pck_curve(errors, limit=0.1, steps=10)
    assert curve["share"].tolist() == [0.25, 0.25, 0.5, 0.5, 0.5] + [0.75] * 6
    assert area_under_curve(errors, 0.1) == pytest.approx((0.1 + 0.08 + 0.05 + 0) / 4 / 0.1)


def test_conformal_distortion_of_known_maps(unit_sphere: Any) -> None:
    vertices, faces, _ = unit_sphere
    rotation = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    assert conformal_distortion(vertices, 3 * vertices @ rotation.T, faces) == pytest.approx(2)
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [0.3, 0.8, 0]])
    one = np.array([[0, 1, 2]])
    assert conformal_distortion(flat, flat * [4, 1, 1], one) == pytest.approx(4 + 1 / 4)
    shear = flat @ np.array([[1, 0, 0], [0.5, 1, 0], [0, 0, 1]])
    singular = np.linalg.svd(np.array([[1, 0.5], [0, 1]]), compute_uv=False)
    expected = singular[0] / singular[1] + singular[1] / singular[0]
    assert conformal_distortion(flat, shear, one) == pytest.approx(expected)
    assert np.isinf(conformal_distortion(flat, flat * [1, 0, 1], one)).all()
    assert np.isinf(conformal_distortion(flat * [1, 0, 1], flat, one)).all()
    assert np.isinf(conformal_distortion(flat, flat * 0, one)).all()

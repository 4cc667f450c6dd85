from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree
from shapes import basis_of, blob

from ssm_pipeline.adaptation.adapt import adapt
from ssm_pipeline.adaptation.correspond import correspond_bases
from ssm_pipeline.adaptation.gauss_newton import gauss_newton
from ssm_pipeline.adaptation.objective import AdaptationObjective, MapPull, Triangles
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.adaptation.vector_adam import vector_adam
from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.records import Mesh


@pytest.fixture(scope="module")
def pair() -> Any:
    return basis_of(blob(1)), basis_of(blob(2))


def triangles(basis: Any) -> Any:
    return Triangles(basis.vertices, basis.faces)


def objective_of(pair: Any, samples: Any = 3000, stiffness: Any = 6.6e-5) -> Any:
    x, y = pair
    return AdaptationObjective(
        triangles(x),
        x.laplacian,
        triangles(y),
        AdaptationSettings(samples=samples, stiffness=stiffness),
        np.random.default_rng(0),
    )


def test_objective_against_brute_force(pair: Any) -> None:
    objective = objective_of(pair, samples=400)
    offsets = 0.02 * np.random.default_rng(1).standard_normal(objective.vertices.shape)
    samples = objective.moved_samples(offsets)
    squared = ((samples[:, None] - objective.target[None]) ** 2).sum(-1)
    chamfer = squared.min(axis=0).mean() + squared.min(axis=1).mean()
    dirichlet = np.trace(offsets.T @ objective.laplacian.toarray() @ offsets)
    assert objective.value(offsets) == pytest.approx(chamfer + 6.6e-5 * dirichlet, rel=1e-9)


def test_gradient_against_finite_differences(pair: Any) -> None:
    objective = objective_of(pair, samples=400)
    generator = np.random.default_rng(1)
    offsets = 0.02 * generator.standard_normal(objective.vertices.shape)
    direction = generator.standard_normal(offsets.shape)
    step = 1e-6  # short enough that no nearest neighbour changes
    numeric = (
        objective.value(offsets + step * direction) - objective.value(offsets - step * direction)
    ) / (2 * step)
    assert (objective.gradient(offsets) * direction).sum() == pytest.approx(numeric, rel=1e-3)


def test_gauss_newton_reaches_what_vector_adam_reaches() -> None:
    # A pair far enough apart that the surfaces, not the samples' noise, decide the objective.
    other = blob(2)
    far = basis_of(Mesh(other.vertices * [1.5, 1.0, 0.8], other.faces, "far"))
    objective = objective_of((basis_of(blob(1)), far), samples=10_000)
    offsets, values = gauss_newton(objective, steps=10)
    _, reference = vector_adam(objective, steps=250, learning_rate=2e-3)
    assert objective.value(offsets) == pytest.approx(min(values))
    assert min(values) <= reference[-1]


def test_the_last_steps_never_raise_the_objective(pair: Any) -> None:
    _, values = gauss_newton(objective_of(pair), steps=6)
    assert values[-1] <= values[-2] * (1 + 1e-9) <= values[-3] * (1 + 1e-6)


def test_a_strong_pull_brings_every_vertex_to_its_point(pair: Any) -> None:
    x, y = pair
    settings = AdaptationSettings(samples=400)
    points = x.vertices + 0.05 * np.random.default_rng(3).standard_normal(x.vertices.shape)
    pull = MapPull(points, np.full(len(points), 1e6))
    generator = np.random.default_rng(0)
    objective = AdaptationObjective(
        triangles(x), x.laplacian, triangles(y), settings, generator, pull
    )
    offsets, _ = gauss_newton(objective, steps=2)
    np.testing.assert_allclose(offsets, points - x.vertices, atol=1e-5)


def test_adapting_brings_the_surface_onto_the_case(pair: Any) -> None:
    x, y = pair
    settings = AdaptationSettings(samples=8000)
    offsets = adapt(triangles(x), x.laplacian, triangles(y), settings, seed=0).offsets
    moved = x.vertices + offsets
    before = closest_points(x.vertices, y.vertices, y.faces).distances.mean()
    after = closest_points(moved, y.vertices, y.faces).distances.mean()
    # What is left: chords of a mesh of 300 vertices, and the samples' spacing of about 0.006.
    assert after < 0.25 * before


def test_a_shape_on_itself_stays(pair: Any) -> None:
    x, _ = pair
    settings = AdaptationSettings(samples=8000, steps=3)
    offsets = adapt(triangles(x), x.laplacian, triangles(x), settings, seed=0).offsets
    # Two different samples of one surface: it may breathe by a fraction of the sample spacing.
    assert np.linalg.norm(offsets, axis=1).mean() < 0.5 * np.sqrt(1 / 8000)


def test_a_stiff_shape_only_translates(pair: Any) -> None:
    x, y = pair
    settings = AdaptationSettings(samples=2000, stiffness=1e3)
    offsets = adapt(triangles(x), x.laplacian, triangles(y), settings, seed=0).offsets
    assert np.ptp(offsets, axis=0).max() < 1e-3


def test_nearest_point_correspondence_lies_on_the_case_and_names_the_nearest_vertex() -> None:
    template_mesh = blob(1)
    turned = Mesh(
        template_mesh.vertices[::-1] + 3.0,
        len(template_mesh.vertices) - 1 - template_mesh.faces,
        "case",
    )
    template, case = basis_of(template_mesh), basis_of(turned)
    match = correspond_bases(template, case, None, AdaptationSettings(), "nearest point")
    # The case is the template moved and renumbered: each vertex must find itself.
    # Within the noise of aligning two samples of 4000 points of a 100 mm solid.
    np.testing.assert_allclose(match.points_on(turned), template_mesh.vertices + 3.0, atol=1.0)
    expected = np.arange(len(turned.vertices))[::-1]
    assert (match.nearest_vertex == expected).mean() > 0.95
    _, brute = cKDTree(turned.vertices).query(match.fitted)
    assert (match.nearest_vertex == brute).all()


def test_a_network_method_needs_a_network(pair: Any) -> None:
    template, case = pair
    with pytest.raises(ValueError, match="'full' needs a trained matcher"):
        correspond_bases(template, case, None, AdaptationSettings())

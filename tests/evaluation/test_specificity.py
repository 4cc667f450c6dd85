import numpy as np
import pytest
from scipy.spatial import cKDTree
from synthetic_shapes import lattice, speckles, wavy_cohort

from ssm_pipeline.evaluation.sampling import FixedPoints, spatial_order
from ssm_pipeline.evaluation.settings import EvaluationSettings
from ssm_pipeline.evaluation.specificity import (
    drawn_scores,
    nearest_chamfer,
    nearest_surface,
    specificity,
)
from ssm_pipeline.geometry.distances import PointTarget, SurfaceTarget, surface_distance
from ssm_pipeline.geometry.surface import sample_points
from ssm_pipeline.records import Mesh
from ssm_pipeline.shape_model.alignment import align
from ssm_pipeline.shape_model.model import ShapeModel
from ssm_pipeline.shape_model.pca import pca_model

STEP_MM = 3.0


def one_mode_model() -> ShapeModel:
    """Every point moves STEP_MM a standard deviation along z: a draw's distance is |s| STEP_MM."""
    shape = speckles(lattice(4), "mean")
    mode = np.zeros_like(shape.vertices)
    mode[:, 2] = 1 / np.sqrt(len(mode))
    return ShapeModel(
        mean=shape.vertices,
        modes=mode[None],
        variances=np.array([len(mode) * STEP_MM**2]),
        faces=shape.faces,
        scores=np.array([[1.0], [0.0], [-1.0]]),
        case_ids=("a", "b", "c"),
    )


def test_one_gaussian_mode_by_hand() -> None:
    # One mesh at the mean: E|s| = √(2/π), Var|s| = 1 − 2/π.
    model = one_mode_model()
    settings = EvaluationSettings(points=64, samples=2000)
    mesh = Mesh(model.mean, model.faces, "a")
    row = specificity(model, [mesh], settings, np.random.default_rng(0))[0].iloc[0]
    error = STEP_MM * np.sqrt((1 - 2 / np.pi) / 2000)
    assert row["chamfer_mm"] == pytest.approx(STEP_MM * np.sqrt(2 / np.pi), abs=4 * error)
    assert row["chamfer_se_mm"] == pytest.approx(error, rel=0.1)
    assert row["samples"] == 2000
    assert row["points"] == 64
    assert row["chamfer_floor_mm"] == pytest.approx(0, abs=1e-3)


def test_the_nearer_of_two_meshes_counts() -> None:
    # Meshes at ±1 standard deviation: the distance is ||s| − 1|.
    model = one_mode_model()
    meshes = [Mesh(model.reconstruct([s]), model.faces, str(s)) for s in (-1.0, 1.0)]
    settings = EvaluationSettings(points=64, samples=2000)
    row = specificity(model, meshes, settings, np.random.default_rng(0))[0].iloc[0]
    scores = np.linspace(-8, 8, 200_001)
    density = np.exp(-(scores**2) / 2) / np.sqrt(2 * np.pi)
    distance = np.abs(np.abs(scores) - 1)
    expected = STEP_MM * np.trapezoid(distance * density, scores)
    assert row["chamfer_mm"] == pytest.approx(expected, abs=4 * row["chamfer_se_mm"])


def test_standard_error_is_the_spread_of_repeated_runs() -> None:
    model = one_mode_model()
    settings = EvaluationSettings(points=64, samples=60)
    mesh = [Mesh(model.mean, model.faces, "a")]
    rows = [
        specificity(model, mesh, settings, np.random.default_rng(seed))[0].iloc[0]
        for seed in range(80)
    ]
    spread = np.std([row["chamfer_mm"] for row in rows], ddof=1)
    # A standard deviation from 80 runs is itself uncertain by 8 %.
    assert np.mean([row["chamfer_se_mm"] for row in rows]) == pytest.approx(spread, rel=0.25)


def test_fast_equals_naive() -> None:
    corresponded, _ = wavy_cohort(9, subdivisions=3)
    aligned, _ = align(corresponded)
    model = pca_model(aligned)
    generator = np.random.default_rng(0)
    points = FixedPoints.of(model.mean, model.faces, 800, generator)
    samples = [sample_points(v, model.faces, 800, generator) for v in aligned.vertices]
    samples = [sample[spatial_order(sample)] for sample in samples]
    draws = points.on(model.sample(100, generator)).astype(np.float32)
    fast, left = nearest_chamfer(draws, [PointTarget.of(s) for s in samples], 128, 2.0)
    trees = [cKDTree(sample) for sample in samples]
    naive = np.empty((len(draws), len(samples)))
    for index, draw in enumerate(draws):
        tree = cKDTree(draw)
        for target, sample in enumerate(samples):
            naive[index, target] = (
                trees[target].query(draw)[0].mean() + tree.query(sample)[0].mean()
            ) / 2
    assert fast == pytest.approx(naive.min(axis=1), rel=1e-5)  # float32
    assert np.mean([len(kept) for kept in left]) < 0.6 * len(samples)  # and it does spare work


def test_surface_distance_of_draws_equals_naive() -> None:
    corresponded, _ = wavy_cohort(5)
    aligned, _ = align(corresponded)
    model = pca_model(aligned)
    meshes = [
        Mesh(v, aligned.faces, i) for v, i in zip(aligned.vertices, aligned.case_ids, strict=True)
    ]
    settings = EvaluationSettings(
        points=400, samples=20, surface_samples=20, surface_points=5000, screening_errors=100
    )
    table, per_draw = specificity(model, meshes, settings, np.random.default_rng(3))
    # The same draws again: the generator is asked for points and samples first.
    generator = np.random.default_rng(3)
    points = FixedPoints.of(model.mean, model.faces, 400, generator)
    for _ in range(2):
        for mesh in meshes:
            sample_points(mesh.vertices, mesh.faces, points.count, generator)
    scores = drawn_scores(model, generator.standard_normal((20, 5)))
    targets = [SurfaceTarget.of(mesh.vertices, mesh.faces) for mesh in meshes]
    for modes in (1, model.mode_count):
        best = []
        for shape in model.reconstruct(scores[:, :modes]):
            draw = SurfaceTarget.of(shape, model.faces)
            best.append(min(surface_distance(draw, target).mean for target in targets))
        row = table[table["modes"] == modes]
        # Of the two meshes nearest by Chamfer; a third that is nearest by surface is rare.
        assert row["surface_mm"].item() == pytest.approx(np.mean(best), rel=0.01)
        assert row["surface_mm"].item() >= np.mean(best) - 1e-9
        drawn = per_draw.loc[per_draw["modes"] == modes, "surface_mm"]
        assert drawn.mean() == pytest.approx(row["surface_mm"].item())


def test_draws_have_the_models_covariance_and_pair_between_models() -> None:
    corresponded, _ = wavy_cohort(6)
    aligned, _ = align(corresponded)
    model = pca_model(aligned)
    weights = np.random.default_rng(0).standard_normal((4000, 6))
    scores = drawn_scores(model, weights)
    # 4000 draws: entries of the covariance are uncertain by 1 / sqrt(4000), 0.016.
    assert np.cov(scores.T) == pytest.approx(np.eye(model.mode_count), abs=0.08)
    # Modes of the same shapes in another order and with other signs draw the same shapes.
    turned = ShapeModel(
        model.mean,
        -model.modes[::-1],
        model.variances[::-1],
        model.faces,
        -model.scores[:, ::-1],
        model.case_ids,
    )
    again = turned.reconstruct(drawn_scores(turned, weights[:3]))
    assert again == pytest.approx(model.reconstruct(scores[:3]))


def test_points_are_even_and_move_with_the_shape() -> None:
    corresponded, _ = wavy_cohort(3, subdivisions=3)
    generator = np.random.default_rng(0)
    first, second = corresponded.vertices[:2]
    points = FixedPoints.of(first, corresponded.faces, 300, generator)
    assert points.on(corresponded.vertices).shape == (3, 300, 3)
    moved = points.on(first + np.array([1, 2, 3])) - points.on(first)
    assert moved == pytest.approx(np.broadcast_to([1.0, 2, 3], moved.shape))
    middle = points.on((first + second) / 2)
    assert middle == pytest.approx((points.on(first) + points.on(second)) / 2)


def test_both_distances_are_to_the_same_mesh() -> None:
    """The nearest mesh on average has the larger HD95: one of its corners is far away."""
    shape = speckles(lattice(4), "shape")
    spike, apart = shape.vertices.copy(), shape.vertices + np.array([0, 0, 5.0])
    spike[:12] += [0, 0, 40.0]  # 4 of 64 speckles: 6 %, so that the 95th percentile sees them
    surfaces = [SurfaceTarget.of(each, shape.faces) for each in (apart, spike)]
    (found,) = nearest_surface(shape.vertices[None], shape.faces, surfaces, [np.array([0, 1])], 999)
    assert found[0] == pytest.approx(2.5, abs=0.01)  # 40 · 4 / 64, and not 5
    assert found[1] == pytest.approx(40.0, abs=0.01)  # and not 5

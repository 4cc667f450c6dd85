"""The matching protocol on shapes whose truth is known."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from ssm_pipeline.data_prep.matching_sets.matching_folder import (
    read_matching_folder,
    write_matching_folder,
)
from ssm_pipeline.data_prep.matching_sets.matching_set import MatchingSet
from ssm_pipeline.evaluation.matching_benchmark import MatchingBenchmark, run_matching_benchmark
from ssm_pipeline.geometry.geodesics import geodesic_matrix
from ssm_pipeline.geometry.surface import area
from ssm_pipeline.records import CaseError, Mesh, StudyError


def distances(mesh: Mesh) -> np.ndarray:
    return geodesic_matrix(mesh.vertices, mesh.faces)


def renumbered_balls(count: int) -> tuple[list[Mesh], list[np.ndarray]]:
    """Spheres of different radius, each numbered in its own order: point r is order[r]."""
    generator = np.random.default_rng(0)
    ball = trimesh.creation.icosphere(2)  # 162 vertices
    meshes, orders = [], []
    for index in range(count):
        order = generator.permutation(len(ball.vertices))
        vertices = np.empty_like(ball.vertices)
        vertices[order] = ball.vertices * (index + 1)
        meshes.append(Mesh(vertices, order[ball.faces], f"ball{index}"))
        orders.append(order)
    return meshes, orders


def true_map(x: Mesh, y: Mesh) -> np.ndarray:
    """On spheres about the origin: the point in the same direction."""
    directions = [mesh.vertices / np.linalg.norm(mesh.vertices, axis=1)[:, None] for mesh in (x, y)]
    return np.asarray((directions[1] @ directions[0].T).argmax(axis=1))


def run(
    meshes: Any, orders: Any, predict: Any, with_self_pairs: Any = False, **options: Any
) -> MatchingBenchmark:
    shapes = MatchingSet(tuple(meshes), tuple(orders))
    known = shapes.known_pairs(range(len(meshes)), with_self_pairs)
    return run_matching_benchmark(meshes, known, predict, distances, "balls", "m", **options)


def test_the_true_map_has_no_error() -> None:
    result = run(*renumbered_balls(3), true_map)
    row = result.summary.iloc[0]
    assert (row["benchmark"], row["method"], row["shapes"], row["pairs"]) == ("balls", "m", 3, 6)
    assert row["mean_geodesic_error_x100"] == 0
    assert row["auc"] == pytest.approx(1)
    assert row["pck_005_percent"] == 100
    assert (result.curve["share"] == 1).all()
    assert list(zip(result.pairs["x"], result.pairs["y"], strict=True))[:3] == [
        ("ball0", "ball1"),
        ("ball0", "ball2"),
        ("ball1", "ball0"),
    ]


def test_a_shape_against_itself_with_the_identity() -> None:
    meshes, orders = renumbered_balls(2)
    calls: list[tuple[int, int]] = []
    generator = np.random.default_rng(2)

    def predict(x: Mesh, y: Mesh) -> np.ndarray:
        if x is y:
            return np.arange(len(x.vertices))
        return generator.integers(0, len(x.vertices), len(y.vertices))

    result = run(
        meshes, orders, predict, with_self_pairs=True, on_pair=lambda *call: calls.append(call)
    )
    own = result.pairs["x"] == result.pairs["y"]
    assert own.sum() == 2
    assert (result.pairs.loc[own, "mean_geodesic_error_x100"] == 0).all()
    assert (result.pairs.loc[~own, "mean_geodesic_error_x100"] > 10).all()
    assert calls == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_a_random_map_is_at_chance_level() -> None:
    meshes, orders = renumbered_balls(4)
    generator = np.random.default_rng(1)
    result = run(
        meshes, orders, lambda x, y: generator.integers(0, len(x.vertices), len(y.vertices))
    )
    # Chance: the mean of the whole matrix, over √area; on the sphere (π/2) r / √(4π r²) = 0.443,
    # whatever the radius. Twelve pairs of 162 draws: standard error about 0.004.
    chance = distances(meshes[0]).mean() / np.sqrt(area(meshes[0].vertices, meshes[0].faces))
    assert chance == pytest.approx(0.443, abs=0.02)
    found = result.summary.iloc[0]["mean_geodesic_error_x100"] / 100
    assert found == pytest.approx(chance, abs=0.016)


def test_the_error_is_the_geodesic_on_x_between_match_and_truth() -> None:
    meshes, orders = renumbered_balls(2)
    D = distances(meshes[0])[np.ix_(orders[0], orders[0])]
    shift = D.argsort(axis=1)[:, 1]  # in the template's numbering: every point to its nearest

    def shifted(x: Mesh, y: Mesh) -> np.ndarray:
        x_order, y_order = (orders[int(mesh.case_id[-1])] for mesh in (x, y))
        y_to_x = np.empty(162, dtype=int)
        y_to_x[y_order] = x_order[shift]
        return y_to_x

    result = run(meshes, orders, shifted)
    errors = D[shift, np.arange(162)] / np.sqrt(area(meshes[0].vertices, meshes[0].faces))
    first = result.pairs.iloc[0]
    assert first["mean_geodesic_error_x100"] == pytest.approx(100 * errors.mean(), rel=1e-6)
    assert first["median_geodesic_error_x100"] == pytest.approx(100 * np.median(errors), rel=1e-6)
    # The radii differ, √area with them: both pairs have the same curve. It reaches 1 within the
    # range, since the nearest vertex is 0.08 √area away.
    shares = [(errors <= threshold).mean() for threshold in result.curve["threshold"]]
    assert result.curve["share"].to_numpy() == pytest.approx(np.array(shares), abs=0.01)
    assert 0 == shares[0] < shares[-1] == 1


def test_files_that_count_from_one_give_the_same_result(tmp_path: Path) -> None:
    meshes, orders = renumbered_balls(2)
    write_matching_folder(tmp_path, meshes, orders)
    shapes = read_matching_folder(tmp_path)
    assert isinstance(shapes, MatchingSet)
    result = run(shapes.meshes, shapes.template_to_shape, true_map)
    assert result.summary.iloc[0]["mean_geodesic_error_x100"] == 0
    off_by_one = [(order + 1) % 162 for order in orders]
    assert run(meshes, off_by_one, true_map).summary.iloc[0]["mean_geodesic_error_x100"] > 1


def test_bad_input_is_named() -> None:
    meshes, orders = renumbered_balls(2)
    with pytest.raises(StudyError, match="no pair of test shapes whose correspondence is known"):
        run(meshes[:1], orders[:1], true_map)
    with pytest.raises(StudyError, match="ball1 has correspondences for 9 template vertices"):
        run(meshes, [orders[0], orders[1][:9]], true_map)
    with pytest.raises(CaseError, match=r"case ball1: the map to ball0 is int64 of shape \(3,\)"):
        run(meshes, orders, lambda x, y: np.arange(3))
    with pytest.raises(CaseError, match="case ball1: the map to ball0 is float64"):
        run(meshes, orders, lambda x, y: np.zeros(162))
    with pytest.raises(CaseError, match="names vertices 1 to 162; 0 to 161 exist"):
        run(meshes, orders, lambda x, y: np.arange(162) + 1)

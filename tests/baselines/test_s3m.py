"""S3M from meshes to corresponding points, on small shapes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
import trimesh

from ssm_pipeline.baselines.s3m.s3m import run_s3m
from ssm_pipeline.baselines.s3m.settings import S3MSettings
from ssm_pipeline.geometry.topology import boundary_loop_count, euler_number
from ssm_pipeline.records import CaseError, Mesh, StudyError

CPU = torch.device("cpu")
SMALL = S3MSettings(
    eigenfunctions=8, dense_points=500, points=200, feature_size=16, epochs=2, shapes_per_step=4
)


def organ(stretch: float, case_id: str) -> Mesh:
    """An egg without symmetry of 642 vertices, about 100 mm long."""
    x = trimesh.creation.icosphere(3, 1.0)
    v = x.vertices * [35.0, 22.0, 50.0]
    v[:, 0] += 0.012 * (v[:, 2] + 10) ** 2 * stretch
    v[:, 1] += 0.2 * v[:, 2] * np.exp(-((v[:, 0] - 15) ** 2) / 400)
    return Mesh(v + 100, x.faces, case_id)


def ignore(what: str, done: int, of: int) -> None:
    pass


def test_identical_shapes_get_the_identity() -> None:
    meshes = [organ(1.0, name) for name in ("a", "b", "c")]
    result = run_s3m(meshes, SMALL, 0, CPU, ignore)
    points = result.points.vertices
    assert points.shape == (3, 200, 3)
    assert boundary_loop_count(result.points.faces) == 0  # joined to a closed surface
    assert euler_number(result.points.faces) == 2
    assert np.array_equal(points[0], points[1])
    assert np.array_equal(points[0], points[2])
    assert result.template_losses == pytest.approx(np.zeros(3), abs=1e-4)


def test_the_points_are_each_cases_own_vertices_each_once() -> None:
    meshes = [organ(s, f"case{s}") for s in (0.7, 1.0, 1.3)]
    calls: list[tuple[str, int, int]] = []
    result = run_s3m(meshes, SMALL, 0, CPU, lambda *call: calls.append(call))
    for mesh, points in zip(meshes, result.points.vertices, strict=True):
        own = {tuple(vertex) for vertex in mesh.vertices}
        taken = {tuple(point) for point in points}
        assert taken <= own
        assert len(taken) == 200
    assert result.template_id == result.points.template_id
    template = result.points.case_ids.index(result.template_id)
    assert result.template_losses[template] == result.template_losses.min()
    assert len(result.epoch_losses) == 2
    assert [call for call in calls if call[1] == call[2]] == [
        ("sample", 3, 3),
        ("train", 12, 12),  # 9 copies have 81 ordered pairs: 6 steps of 16, twice
        ("match", 3, 3),
    ]


def test_points_correspond_where_the_samples_are_ordered_differently() -> None:
    # The two eggs differ by up to 6 mm in x, which changes the order of the farthest points.
    first, second = organ(1.0, "first"), organ(1.15, "second")
    points = run_s3m([first, second], SMALL, 0, CPU, ignore).points.vertices
    true = {tuple(vertex): index for index, vertex in enumerate(first.vertices)}
    where = second.vertices[[true[tuple(point)] for point in points[0]]]
    error = np.linalg.norm(points[1] - where, axis=1).mean()
    chance = np.linalg.norm(points[1][::-1] - where, axis=1).mean()
    assert error < 0.2 * chance


def test_the_same_seed_gives_the_same_bits() -> None:
    meshes = [organ(s, f"case{s}") for s in (0.8, 1.2)]
    first, again = (run_s3m(meshes, SMALL, 3, CPU, ignore) for _ in range(2))
    other = run_s3m(meshes, SMALL, 4, CPU, ignore)
    assert np.array_equal(first.points.vertices, again.points.vertices)
    assert np.array_equal(first.epoch_losses, again.epoch_losses)
    assert not np.array_equal(first.epoch_losses, other.epoch_losses)


def test_training_lowers_the_loss() -> None:
    meshes = [organ(s, f"case{s}") for s in (0.7, 1.0, 1.3)]
    settings = SMALL.model_copy(update={"epochs": 12, "learning_rate": 1e-3})
    losses = run_s3m(meshes, settings, 0, CPU, ignore).epoch_losses
    assert losses[-3:].mean() < 0.5 * losses[0]


def test_one_size_matches_a_shape_to_its_enlargement() -> None:
    # Doubling is exact in floating point, so at one size the two are the same to the last bit.
    small = organ(1.0, "small")
    large = dataclasses.replace(small, vertices=2 * small.vertices, case_id="large")
    settings = SMALL.tuned()
    assert settings.points == SMALL.points
    points = run_s3m([small, large], settings, 0, CPU, ignore).points.vertices
    assert np.array_equal(points[1], 2 * points[0])


def test_bad_input_is_named() -> None:
    with pytest.raises(StudyError, match="at least 2 cases; 1 given"):
        run_s3m([organ(1.0, "a")], SMALL, 0, CPU, ignore)
    with pytest.raises(CaseError, match="case a: the mesh has 642 vertices; S3M samples 2048"):
        run_s3m([organ(1.0, "a"), organ(1.0, "b")], S3MSettings(), 0, CPU, ignore)
    one = organ(1.0, "b")
    apart = Mesh(
        np.concatenate([one.vertices, one.vertices + 300]),
        np.concatenate([one.faces, one.faces + len(one.vertices)]),
        "two",
    )
    with pytest.raises(CaseError, match="case two: the surface is in several pieces"):
        run_s3m([one, apart], SMALL, 0, CPU, ignore)

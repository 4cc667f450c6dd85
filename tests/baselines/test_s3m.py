"""S3M from meshes to corresponding points, on small shapes."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
import torch
import trimesh

from ssm_pipeline.baselines.s3m.epochs import S3MCheckpoint, batches, train_extractor
from ssm_pipeline.baselines.s3m.s3m import S3MMatch, match_s3m, train_s3m
from ssm_pipeline.baselines.s3m.samples import drawn_sample, training_copies
from ssm_pipeline.baselines.s3m.settings import S3MSettings
from ssm_pipeline.geometry.topology import boundary_loop_count, euler_number
from ssm_pipeline.records import CaseError, Mesh, StudyError

CPU = torch.device("cpu")
SMALL = S3MSettings(
    eigenfunctions=8, dense_points=500, points=200, feature_size=16, epochs=2, copies_per_step=4
)


def organ(stretch: float, case_id: str) -> Mesh:
    """An egg without symmetry of 642 vertices, about 100 mm long."""
    x = trimesh.creation.icosphere(3, 1.0)
    v = x.vertices * [35.0, 22.0, 50.0]
    v[:, 0] += 0.012 * (v[:, 2] + 10) ** 2 * stretch
    v[:, 1] += 0.2 * v[:, 2] * np.exp(-((v[:, 0] - 15) ** 2) / 400)
    return Mesh(v + 100, x.faces, case_id)


def run_s3m(
    meshes: list[Mesh], settings: S3MSettings, seed: int, on_progress: Any = None
) -> tuple[S3MMatch, list[float]]:
    """Both halves: what came of it, and the loss of each epoch."""
    progress = on_progress or ignore
    trained = train_s3m(meshes, settings, seed, CPU, progress)
    return match_s3m(meshes, trained, settings, seed, CPU, progress), trained.losses


def ignore(what: str, done: int, of: int) -> None:
    pass


def test_identical_shapes_get_the_identity() -> None:
    meshes = [organ(1.0, name) for name in ("a", "b", "c")]
    result, _ = run_s3m(meshes, SMALL, 0)
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
    result, losses = run_s3m(meshes, SMALL, 0, lambda *call: calls.append(call))
    for mesh, points in zip(meshes, result.points.vertices, strict=True):
        own = {tuple(vertex) for vertex in mesh.vertices}
        taken = {tuple(point) for point in points}
        assert taken <= own
        assert len(taken) == 200
    template = result.points.case_ids.index(result.points.template_id)
    assert result.template_losses[template] == result.template_losses.min()
    assert len(losses) == 2
    assert [call for call in calls if call[1] == call[2]] == [
        ("sample", 3, 3),
        ("train", 12, 12),  # 9 copies have 81 ordered pairs: 6 steps of 16, twice
        ("match", 3, 3),
    ]


def test_points_correspond_where_the_samples_are_ordered_differently() -> None:
    # The two eggs differ by up to 6 mm in x, which changes the order of the farthest points.
    first, second = organ(1.0, "first"), organ(1.15, "second")
    points = run_s3m([first, second], SMALL, 0)[0].points.vertices
    true = {tuple(vertex): index for index, vertex in enumerate(first.vertices)}
    where = second.vertices[[true[tuple(point)] for point in points[0]]]
    error = np.linalg.norm(points[1] - where, axis=1).mean()
    chance = np.linalg.norm(points[1][::-1] - where, axis=1).mean()
    assert error < 0.2 * chance


def test_the_same_seed_gives_the_same_bits() -> None:
    meshes = [organ(s, f"case{s}") for s in (0.8, 1.2)]
    (first, losses), (again, losses_again) = (run_s3m(meshes, SMALL, 3) for _ in range(2))
    _, other = run_s3m(meshes, SMALL, 4)
    assert np.array_equal(first.points.vertices, again.points.vertices)
    assert losses == losses_again
    assert losses != other


def test_training_that_was_stopped_goes_on_to_the_same_bits() -> None:
    meshes = [organ(s, f"case{s}") for s in (0.8, 1.2)]
    settings = SMALL.model_copy(update={"epochs": 3, "learning_rate": 1e-2})
    kept: list[S3MCheckpoint] = []
    whole = train_s3m(meshes, settings, 0, CPU, ignore, on_epoch=kept.append)
    assert [checkpoint.epoch for checkpoint in kept] == [1, 2, 3]
    going_on = train_s3m(meshes, settings, 0, CPU, ignore, start=kept[0])
    assert going_on.losses == whole.losses
    for name, weights in whole.network.items():
        assert torch.equal(weights, going_on.network[name])
    # A shorter training ends where the longer one passed: one training gives the scores at both.
    short = train_s3m(meshes, settings.model_copy(update={"epochs": 1}), 0, CPU, ignore)
    assert torch.equal(short.network["last.weight"], kept[0].network["last.weight"])
    assert not torch.equal(short.network["last.weight"], whole.network["last.weight"])


def test_every_epoch_draws_its_own_samples_and_pairs(monkeypatch: pytest.MonkeyPatch) -> None:
    from ssm_pipeline.baselines.s3m import epochs

    drawn: list[tuple[int, ...]] = []

    def spy(*arguments: Any) -> Any:
        sample = drawn_sample(*arguments)
        drawn.append(tuple(sample.vertices))
        return sample

    monkeypatch.setattr(epochs, "drawn_sample", spy)
    copies = training_copies(organ(1.0, "a"), SMALL, np.random.default_rng(0))
    train_extractor(copies, SMALL, 0, CPU, lambda done, of: None)
    assert len(drawn) == 2 * len(copies)
    assert all(drawn[k] != drawn[k + len(copies)] for k in range(len(copies)))


def test_published_batches_hold_every_ordered_pair_once_an_epoch() -> None:
    settings = S3MSettings(pairs_per_step=7)
    parts = batches(6, settings, np.random.default_rng(0))
    assert [len(part) for part in parts] == [7] * 5 + [1]
    assert {tuple(pair) for part in parts for pair in part} == {
        (x, y) for x in range(6) for y in range(6)
    }
    few = batches(6, S3MSettings(copies_per_step=3), np.random.default_rng(0))
    assert [len(part) for part in few] == [9] * 4
    assert all(len(np.unique(part)) == 3 for part in few)


@pytest.mark.parametrize("copies_per_step", [None, 4])
def test_training_lowers_the_loss(copies_per_step: int | None) -> None:
    meshes = [organ(s, f"case{s}") for s in (0.7, 1.0, 1.3)]
    changes = {"epochs": 12, "learning_rate": 1e-3, "copies_per_step": copies_per_step}
    settings = SMALL.model_copy(update={**changes, "pairs_per_step": 16})
    losses = train_s3m(meshes, settings, 0, CPU, ignore).losses
    assert np.mean(losses[-3:]) < 0.5 * losses[0]


def test_one_size_matches_a_shape_to_its_enlargement() -> None:
    # Doubling is exact in floating point, so at one size the two are the same to the last bit; and
    # so is the filter, where its kernel grows with the organ.
    small = organ(1.0, "small")
    large = dataclasses.replace(small, vertices=2 * small.vertices, case_id="large")
    settings = SMALL.tuned().model_copy(update={"one_size": True})
    points = run_s3m([small, large], settings, 0)[0].points.vertices
    assert np.array_equal(points[1], 2 * points[0])


def test_the_reference_is_one_of_the_cases_seen() -> None:
    meshes = [organ(s, f"case{s}") for s in (0.7, 1.0, 1.3)]
    trained = train_s3m(meshes[:2], SMALL, 0, CPU, ignore)
    for seen in ("case0.7", "case1.0"):
        match = match_s3m(meshes, trained, SMALL, 0, CPU, ignore, seen=[seen])
        assert match.points.template_id == seen
        assert len(match.points.vertices) == 3


def test_two_processes_match_as_one_does() -> None:
    meshes = [organ(s, f"case{s}") for s in (0.7, 1.0, 1.3)]
    trained = train_s3m(meshes, SMALL, 0, CPU, ignore)
    one, two = (match_s3m(meshes, trained, SMALL, 0, CPU, ignore, jobs=jobs) for jobs in (1, 2))
    assert np.array_equal(one.points.vertices, two.points.vertices)


def test_bad_input_is_named() -> None:
    with pytest.raises(StudyError, match="at least 2 cases; 1 given"):
        run_s3m([organ(1.0, "a")], SMALL, 0)
    with pytest.raises(CaseError, match="case a: the mesh has 642 vertices; S3M samples 2048"):
        run_s3m([organ(1.0, "a"), organ(1.0, "b")], S3MSettings(), 0)
    one = organ(1.0, "b")
    apart = Mesh(
        np.concatenate([one.vertices, one.vertices + 300]),
        np.concatenate([one.faces, one.faces + len(one.vertices)]),
        "two",
    )
    trained = train_s3m([one, apart], SMALL, 0, CPU, ignore)
    for jobs in (1, 2):
        with pytest.raises(CaseError, match="case two: the surface is in several pieces"):
            match_s3m([one, apart], trained, SMALL, 0, CPU, ignore, jobs=jobs)

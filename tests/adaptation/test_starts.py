"""Adaptation from several starts: which is kept."""

import numpy as np
import pytest
from shapes import basis_of, blob

from ssm_pipeline.adaptation.correspond import correspond_bases
from ssm_pipeline.adaptation.distortion import distortion
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.matching.settings import MatchingSettings
from ssm_pipeline.records import Mesh
from ssm_pipeline.training.settings import TrainingSettings
from ssm_pipeline.training.train import train_networks

SETTINGS = AdaptationSettings(samples=3000, steps=4)


@pytest.fixture(scope="module")
def bases():
    return [basis_of(blob(index)) for index in (1, 2, 3)]


@pytest.fixture(scope="module")
def untrained(bases):
    small = MatchingSettings(features="wks", descriptors=16, channels=8, width=16, blocks=2)
    return train_networks(bases, TrainingSettings(steps=1, matching=small), seed=0)


def test_a_rigid_motion_distorts_nothing_and_an_even_stretch_by_its_dirichlet_energy(bases) -> None:
    basis = bases[0]
    L, x = basis.laplacian, basis.vertices
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    turn *= np.linalg.det(turn)
    assert distortion(x, x @ turn.T + 3.0, L) == pytest.approx(0.0, abs=1e-12)
    larger = 1e-3 * x  # no one-ring turns
    assert distortion(x, x + larger, L) == pytest.approx(dirichlet(larger, L))
    uneven = 1e-3 * x * [1.0, 0.0, 0.0]
    assert 0 < distortion(x, x + uneven, L) < dirichlet(uneven, L)


def dirichlet(offset, L):
    return float((offset * (L @ offset)).sum())


def test_a_network_that_lays_the_template_across_loses_against_the_rigid_start(
    untrained, monkeypatch: pytest.MonkeyPatch
) -> None:
    from ssm_pipeline.adaptation import pose

    template, case = (
        basis_of(Mesh(mesh.vertices * [1, 1, 4], mesh.faces, mesh.case_id))
        for mesh in (blob(1), blob(2))
    )
    across = case.vertices[:, [1, 2, 0]]
    monkeypatch.setattr(pose, "carried_case", lambda *_: across)
    monkeypatch.setattr(pose, "pose_path", lambda *_: across[None])
    full, rigid, network = (
        correspond_bases(template, case, untrained, SETTINGS, method)
        for method in ("full", "adaptation only", "network start")
    )
    assert (full.start, rigid.start, network.start) == ("rigid", "rigid", "network")
    np.testing.assert_array_equal(full.fitted, rigid.fitted)
    assert not np.allclose(full.fitted, network.fitted)


def test_where_all_starts_reach_the_case_the_maps_turn_is_kept(
    bases, untrained, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A few percent of the cost tell nothing; without a margin they decide."""
    from ssm_pipeline.adaptation import correspond as module
    from ssm_pipeline.adaptation import pose

    template, case = bases[0], bases[1]
    tilt = np.array([[np.cos(0.05), -np.sin(0.05), 0], [np.sin(0.05), np.cos(0.05), 0], [0, 0, 1]])
    better = module.rigidly_aligned(template, case, 0)
    monkeypatch.setattr(pose, "carried_case", lambda *_: better @ tilt)
    monkeypatch.setattr(pose, "pose_path", lambda *_: better[None])
    assert correspond_bases(template, case, untrained, SETTINGS).start == "turned"
    costs = iter([1.0, 0.8, 0.9])
    monkeypatch.setattr(module, "distortion", lambda *_: 1e6 * next(costs))
    assert correspond_bases(template, case, untrained, SETTINGS).start == "turned"
    costs = iter([1.0, 0.7, 0.6])
    assert correspond_bases(template, case, untrained, SETTINGS).start == "network"


def test_the_network_wins_where_the_rigid_start_cannot_reach(
    bases, untrained, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A case turned over: aligned rigidly it stays the wrong way round, the network's pose not."""
    from ssm_pipeline.adaptation import correspond as module
    from ssm_pipeline.adaptation import pose

    template = bases[0]
    upside_down = Mesh(template.vertices * [-1, -1, 1], template.faces, "turned")
    case = basis_of(upside_down)
    monkeypatch.setattr(module, "rigidly_aligned", lambda template, case, seed: template.vertices)
    monkeypatch.setattr(pose, "pose_path", lambda *_: case.vertices[None])
    match = correspond_bases(template, case, untrained, SETTINGS)
    assert match.start in ("network", "turned")  # the map of equal shapes turns it rightly, too
    assert (match.nearest_vertex == np.arange(len(case.vertices))).mean() > 0.95


def test_the_papers_start_alone_is_a_setting(bases, untrained) -> None:
    paper = SETTINGS.model_copy(update={"starts": "network"})
    full = correspond_bases(bases[0], bases[1], untrained, paper)
    network = correspond_bases(bases[0], bases[1], untrained, SETTINGS, "network start")
    np.testing.assert_array_equal(full.fitted, network.fitted)
    assert full.start == "network"

"""Adaptation from several starts: which is kept."""

import re
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from shapes import bar_mesh, basis_of, bent_bar, blob

from ssm_pipeline.adaptation.correspond import correspond_bases
from ssm_pipeline.adaptation.distortion import distortion
from ssm_pipeline.adaptation.map_start import map_start
from ssm_pipeline.adaptation.rigid_start import rigidly_aligned
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.adaptation.starts import kept_start, starts_from_map
from ssm_pipeline.matching.settings import MatchingSettings
from ssm_pipeline.records import Mesh, SpectralBasis
from ssm_pipeline.training.matcher import Matcher
from ssm_pipeline.training.settings import TrainingSettings
from ssm_pipeline.training.train import train_networks

SETTINGS = AdaptationSettings(samples=3000, steps=4)


@pytest.fixture(scope="module")
def bases() -> list[SpectralBasis]:
    return [basis_of(blob(index)) for index in (1, 2, 3)]


@pytest.fixture(scope="module")
def untrained(bases: Any) -> Matcher:
    small = MatchingSettings(features="wks", descriptors=16, channels=8, width=16, blocks=2)
    return train_networks(bases, TrainingSettings(steps=1, matching=small), seed=0)


def test_a_rigid_motion_distorts_nothing_and_an_even_stretch_by_its_dirichlet_energy(
    bases: Any,
) -> None:
    basis = bases[0]
    L, x = basis.laplacian, basis.vertices
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    turn *= np.linalg.det(turn)
    assert distortion(x, x @ turn.T + 3.0, L) == pytest.approx(0.0, abs=1e-12)
    larger = 1e-3 * x  # no one-ring turns
    assert distortion(x, x + larger, L) == pytest.approx(dirichlet(larger, L))
    uneven = 1e-3 * x * [1.0, 0.0, 0.0]
    assert 0 < distortion(x, x + uneven, L) < dirichlet(uneven, L)


def dirichlet(offset: Any, L: Any) -> float:
    return float((offset * (L @ offset)).sum())


def test_a_network_that_lays_the_template_across_loses_against_the_rigid_start(
    untrained: Any, monkeypatch: pytest.MonkeyPatch
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


def test_where_both_starts_reach_the_case_the_rotation_of_the_map_is_kept(
    bases: Any, untrained: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A few percent of the cost tell nothing."""
    from ssm_pipeline.adaptation import pose, starts

    template, case = bases[0], bases[1]
    tilt = Rotation.from_rotvec([0, 0, 0.05])
    targets = tilt.apply(rigidly_aligned(template, case, 0))
    monkeypatch.setattr(pose, "carried_case", lambda *_: targets)
    alone = correspond_bases(template, case, untrained, SETTINGS)
    assert alone.start == "turned"
    assert "rigid" not in alone.start_reason  # the two poses agree: one is adapted
    monkeypatch.setattr(starts, "SAME_POSE_DEG", 1.0)
    for second, kept in ((0.8, "turned"), (0.7, "rigid")):
        costs = iter([1.0, second])
        monkeypatch.setattr(starts, "distortion", lambda *_, costs=costs: 1e6 * next(costs))
        match = correspond_bases(template, case, untrained, SETTINGS)
        assert match.start == kept
        assert re.search(r"turned ends at .*; rigid ends at", match.start_reason)


def test_a_case_turned_over_is_matched_by_the_rotation_of_the_map(
    bases: Any, untrained: Any
) -> None:
    """Rigid alignment by closest points leaves it the wrong way round."""
    template = bases[0]
    case = basis_of(Mesh(template.vertices * [-1, -1, 1], template.faces, "turned"))
    match = correspond_bases(template, case, untrained, SETTINGS)
    assert match.start == "turned"
    assert (match.nearest_vertex == np.arange(len(case.vertices))).mean() > 0.95


@pytest.fixture(scope="module")
def bars() -> tuple[SpectralBasis, SpectralBasis]:
    """A bar, and the same bar bent to most of a circle."""
    straight = bar_mesh(0.4)
    bent = Mesh(bent_bar(straight.vertices, 4.0), straight.faces, "bent")
    return basis_of(straight), basis_of(bent)


def test_a_map_that_bends_the_template_gives_its_pose_and_refuses_rigid_starts(bars: Any) -> None:
    template, case = bars

    def exact(pose: np.ndarray) -> np.ndarray:
        return np.asarray(case.vertices)

    trusted = starts_from_map(template, case, case.vertices, exact, lambda: 0.01, SETTINGS, 0)
    assert [start.name for start in trusted] == ["map"]
    assert np.linalg.norm(trusted[0].pose - case.vertices, axis=1).mean() < 0.03
    doubtful = starts_from_map(template, case, case.vertices, exact, lambda: 0.2, SETTINGS, 0)
    assert [start.name for start in doubtful] == ["map", "rigid"]
    posed, kept = kept_start(doubtful, template, case, SETTINGS, 0)
    assert kept.name == "map"
    assert np.linalg.norm(posed - case.vertices, axis=1).mean() < 0.03
    assert "cycle error 0.200" in kept.why
    assert "rigid ends at" in kept.why


def test_each_further_weight_makes_a_round_from_the_pose_before(bars: Any) -> None:
    template, case = bars
    given: list[np.ndarray] = []

    def map_of_pose(pose: np.ndarray) -> np.ndarray:
        given.append(pose)
        return np.asarray(case.vertices + 0.01)

    weights = SETTINGS.start_map_weights
    found = starts_from_map(template, case, case.vertices, map_of_pose, lambda: 0, SETTINGS, 0)
    rest, L, mass = template.vertices, template.laplacian, template.mass
    assert len(given) == len(weights) - 1 == 1
    np.testing.assert_array_equal(given[0], map_start(rest, case.vertices, L, mass, weights[0]))
    expected = map_start(rest, case.vertices + 0.01, L, mass, weights[1])
    np.testing.assert_array_equal(found[0].pose, expected)
    straight = starts_from_map(template, template, rest, map_of_pose, lambda: 0, SETTINGS, 0)
    assert straight[0].name == "turned"
    assert len(given) == 1  # a rotation needs no refinement


def test_a_doubtful_map_that_tears_the_template_loses_against_the_rigid_start(bars: Any) -> None:
    template, _ = bars
    wrong = template.vertices[np.random.default_rng(0).permutation(len(template.vertices))]
    settings = SETTINGS.model_copy(update={"rigid_below": 0.0})
    starts = starts_from_map(template, template, wrong, lambda _: wrong, lambda: 0.4, settings, 0)
    posed, kept = kept_start(starts, template, template, settings, 0)
    assert kept.name == "rigid"
    assert np.linalg.norm(posed - template.vertices, axis=1).mean() < 0.02


def test_the_papers_start_alone_is_a_setting(bases: Any, untrained: Any) -> None:
    paper = SETTINGS.model_copy(update={"starts": "network"})
    full = correspond_bases(bases[0], bases[1], untrained, paper)
    network = correspond_bases(bases[0], bases[1], untrained, SETTINGS, "network start")
    np.testing.assert_array_equal(full.fitted, network.fitted)
    assert full.start == "network"

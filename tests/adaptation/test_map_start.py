"""The start from a map: known answers."""

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.spatial.transform import Rotation
from shapes import bar_mesh, basis_of, bent_bar, blob

from ssm_pipeline.adaptation.map_start import map_start
from ssm_pipeline.geometry.barycentric import interpolated
from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.records import SpectralBasis

TURN = Rotation.from_rotvec([0.4, -1.1, 2.0])
MU = 100.0


@pytest.fixture(scope="module")
def basis() -> SpectralBasis:
    return basis_of(blob(1))


@pytest.fixture(scope="module")
def bar() -> SpectralBasis:
    """Along x, six times as long as thick."""
    return basis_of(bar_mesh(0.5), 5)


def start_of(basis: Any, targets: Any, weight: Any = MU) -> np.ndarray:
    return map_start(basis.vertices, targets, basis.laplacian, basis.mass, weight)


def test_exact_on_a_rigid_motion(basis: Any) -> None:
    goal = TURN.apply(basis.vertices) + np.array([0.3, 0.1, -2.0])
    np.testing.assert_allclose(start_of(basis, goal), goal, atol=1e-9)


def test_a_vertex_without_a_triangle_stays_at_its_target(bar: Any) -> None:
    """It has neither mass nor edges; the other vertices do not notice it."""
    goal = bent_bar(bar.vertices)
    more = sp.block_diag([bar.laplacian, sp.csr_matrix((1, 1))]).tocsr()
    rest, targets = (np.vstack([points, [[3.0, 0, 0]]]) for points in (bar.vertices, goal))
    with_it = map_start(rest, targets, more, np.append(bar.mass, 0.0), 30.0)
    np.testing.assert_allclose(with_it[-1], targets[-1])
    alone = map_start(bar.vertices, goal, bar.laplacian, bar.mass, 30.0)
    np.testing.assert_allclose(with_it[:-1], alone, atol=1e-6)


def test_near_a_bent_bar_whose_map_is_exact_and_nearer_with_more_weight(bar: Any) -> None:
    goal = bent_bar(bar.vertices)
    off = [np.abs(start_of(bar, goal, weight) - goal).max() for weight in (30, 300, 1e7)]
    assert off[2] < 1e-3 < off[1] < off[0] < 0.03  # of a bar 1 long: its skin must stretch


def test_targets_that_are_wildly_wrong_lose_their_weight(bar: Any) -> None:
    goal = bent_bar(bar.vertices)
    exact = start_of(bar, goal)
    generator = np.random.default_rng(0)
    wild = generator.choice(len(goal), len(goal) // 5, replace=False)
    wrong = goal.copy()
    wrong[wild] = goal[generator.permutation(wild)] + 0.5 * generator.standard_normal(
        (len(wild), 3)
    )
    off = np.linalg.norm(start_of(bar, wrong) - exact, axis=1)
    assert off.mean() < 0.01
    assert np.linalg.norm(wrong - goal, axis=1)[wild].mean() > 0.5


def test_rotating_the_targets_rotates_the_start(basis: Any) -> None:
    noise = 0.03 * np.random.default_rng(1).standard_normal(basis.vertices.shape)
    goal = basis.vertices * [1.1, 0.9, 1.0] + noise
    rotated = start_of(basis, TURN.apply(goal))
    np.testing.assert_allclose(rotated, TURN.apply(start_of(basis, goal)), atol=1e-9)


def test_two_triangulations_of_one_shape_start_alike() -> None:
    coarse, fine = basis_of(bar_mesh(0.5), 5), basis_of(bar_mesh(0.25), 5)
    poses = [start_of(basis, bent_bar(basis.vertices)) for basis in (coarse, fine)]
    place = closest_points(fine.vertices, coarse.vertices, coarse.faces)
    on_coarse = interpolated(poses[0], coarse.faces[place.faces], place.barycentric)
    apart = np.linalg.norm(on_coarse - poses[1], axis=1).mean()
    moved = np.linalg.norm(poses[1] - fine.vertices, axis=1).mean()
    assert apart < 0.05 * moved


def test_the_noise_of_a_map_is_smoothed(basis: Any) -> None:
    goal = TURN.apply(basis.vertices)
    noise = 0.03 * np.random.default_rng(1).standard_normal(goal.shape)
    off = np.linalg.norm(start_of(basis, goal + noise) - goal, axis=1).mean()
    assert off < 0.5 * np.linalg.norm(noise, axis=1).mean()

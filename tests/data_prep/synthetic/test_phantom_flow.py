"""Flows: exact on fields whose flow is known, undone by the reverse, without folds."""

from typing import Any

import numpy as np
import pytest

from ssm_pipeline.data_prep.synthetic.phantom_flow import (
    Bumps,
    Combination,
    Push,
    Swell,
    flow,
    random_velocity,
)


def jacobians(move: Any, points: np.ndarray, step: float = 1e-4) -> np.ndarray:
    """(V, 3, 3) by central differences."""
    columns = [(move(points + o) - move(points - o)) / (2 * step) for o in step * np.eye(3)]
    return np.stack(columns, axis=2)


def test_a_turning_field_turns() -> None:
    turned = flow(np.array([[2.0, 0, 5]]), lambda x: np.cross([0, 0, np.pi / 2], x))
    # Fourth order, eight steps of 11°: an error of 1e-4 of the radius.
    np.testing.assert_allclose(turned, [[0, 2, 5]], atol=1e-4)


def test_the_reverse_field_undoes_a_flow() -> None:
    generator = np.random.default_rng(0)
    points = generator.uniform(-50, 50, (500, 3))
    field = random_velocity(points, 8.0, (30.0, 15.0), generator)
    back = Bumps(field.centres, field.widths, -field.pushes)
    there = flow(points, field, steps=20)
    assert np.linalg.norm(there - points, axis=1).max() > 10
    np.testing.assert_allclose(flow(there, back, steps=20), points, atol=0.01)


def test_large_random_flows_keep_every_volume_positive() -> None:
    """Where the same field, merely added, would fold."""
    generator = np.random.default_rng(3)
    points = generator.uniform(-50, 50, (2000, 3))
    field = random_velocity(points, 20.0, (18.0,), generator)
    added = np.linalg.det(jacobians(lambda x: x + field(x), points))
    flown = np.linalg.det(jacobians(lambda x: flow(x, field, steps=30), points))
    assert added.min() < 0
    assert flown.min() > 0


def test_random_velocities_have_the_size_asked_for() -> None:
    points = np.random.default_rng(1).uniform(-50, 50, (3000, 3))
    field = random_velocity(points, 3.5, (30.0, 16.0), np.random.default_rng(2))
    assert np.sqrt((field(points) ** 2).sum(axis=1).mean()) == pytest.approx(3.5)


def test_pushes_and_swellings_by_hand() -> None:
    push = Push((1.0, 2, 3), (10.0, 20, 30), (0.0, 4, 0))
    np.testing.assert_allclose(push(np.array([[1.0, 2, 3]])), [[0, 4, 0]])
    np.testing.assert_allclose(push(np.array([[1.0, 22, 3]])), [[0, 4 * np.exp(-0.5), 0]])
    swell = Swell((0.0, 0, 0), (10.0, 10, 10), 0.5)
    np.testing.assert_allclose(swell(np.array([[0.0, 10, 0]])), [[0, 5 * np.exp(-0.5), 0]])
    both = Combination((2.0, -1.0), (push, swell))
    x = np.array([[3.0, 4, 5]])
    np.testing.assert_allclose(both(x), 2 * push(x) - swell(x))


def test_bumps_are_a_sum_of_pushes() -> None:
    bumps = Bumps(
        np.array([[0.0, 0, 0], [5, 5, 5]]), np.array([4.0, 8.0]), np.array([[1.0, 0, 0], [0, 2, 0]])
    )
    x = np.random.default_rng(0).uniform(-10, 10, (50, 3))
    by_hand = Push((0.0, 0, 0), (4.0,) * 3, (1.0, 0, 0))(x)
    by_hand += Push((5.0, 5, 5), (8.0,) * 3, (0.0, 2, 0))(x)
    np.testing.assert_allclose(bumps(x), by_hand, atol=1e-12)

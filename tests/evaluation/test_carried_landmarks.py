"""Landmarks on spheres: carried exactly by exact matches, wrong by a known slip."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic_shapes import sphere

from ssm_pipeline.evaluation.carried_landmarks import (
    carried_landmarks,
    landmark_cases,
    landmark_means,
)
from ssm_pipeline.records import CorrespondedShapes

NAMES = ("pole", "equator")


def cohort(slip: float = 0.0) -> tuple[CorrespondedShapes, dict[str, np.ndarray]]:
    """Spheres of 20, 30 and 40 mm, apart; case c is matched with a turn about z by `slip`."""
    directions, faces = sphere(4)
    own = directions[[0, 5]]
    turn = Rotation.from_rotvec([0, 0, slip]).as_matrix()
    radii, shifts = {"a": 20.0, "b": 30.0, "c": 40.0}, {"a": 0.0, "b": 200.0, "c": 500.0}
    points = [
        r * directions @ (turn.T if case == "c" else np.eye(3)) + shifts[case]
        for case, r in radii.items()
    ]
    marks = {case: r * own + shifts[case] for case, r in radii.items()}
    return CorrespondedShapes(np.stack(points), faces, tuple(radii), "a"), marks


def test_exact_matches_carry_landmarks_exactly() -> None:
    shapes, marks = cohort()
    table = carried_landmarks(shapes, marks, NAMES)
    assert len(table) == 3 * 2 * 2
    assert table["error_mm"].max() < 1e-9


def test_a_slip_by_a_known_angle() -> None:
    shapes, marks = cohort(slip=0.1)
    table = carried_landmarks(shapes, marks, NAMES).set_index(["from_case_id", "case_id"])
    sine = np.linalg.norm(sphere(4)[0][[0, 5], :2], axis=1)
    chord = 2 * 40 * sine * np.sin(0.05)
    np.testing.assert_allclose(table.loc[("a", "c"), "error_mm"], chord, rtol=1e-6)
    assert table.loc[("a", "b"), "error_mm"].max() < 1e-9
    # From c the landmark sits between vertices: 0.05 mm of faceting.
    expected = 2 * 20 * sine * np.sin(0.05)
    np.testing.assert_allclose(table.loc[("c", "a"), "error_mm"], expected, atol=0.1)


def test_cases_without_landmarks_are_left_out_and_means_add_up() -> None:
    shapes, marks = cohort(slip=0.1)
    table = carried_landmarks(shapes, {case: marks[case] for case in "ac"}, NAMES)
    assert set(table["case_id"]) == {"a", "c"}
    cases = landmark_cases(table).set_index(["case_id", "landmark"])
    assert cases.loc[("c", "pole"), "error_mm"] == pytest.approx(table["error_mm"].iloc[0])
    perfect = carried_landmarks(cohort()[0], {case: marks[case] for case in "ac"}, NAMES)
    means = landmark_means(
        {"full": table, "exact": perfect}, "full", 200, np.random.default_rng(0)
    ).set_index("method")
    assert means.loc["full", "error_mm"] == pytest.approx(table["error_mm"].mean())
    assert means.loc["full", "cases"] == 2
    assert means.loc["exact", "error_difference_mm"] == pytest.approx(-table["error_mm"].mean())

"""Labels on cylinders: a border shifted by a known length is found shifted by it."""

import numpy as np
import pandas as pd
import pytest

from ssm_pipeline.evaluation.carried_labels import (
    border_length,
    carried_labels,
    label_cases,
    label_means,
)
from ssm_pipeline.evaluation.pair_bootstrap import as_matrix, pair_interval, resampled_cases
from ssm_pipeline.geometry.surface import area
from ssm_pipeline.records import CorrespondedShapes, Mesh, SurfaceLabels

RADIUS, HEIGHT = 10.0, 60.0


def cylinder(rings: int = 41, sides: int = 48) -> tuple[np.ndarray, np.ndarray]:
    """Closed, along z from 0 to HEIGHT, each end a fan."""
    angles = np.arange(sides) * 2 * np.pi / sides
    circle = RADIUS * np.column_stack([np.cos(angles), np.sin(angles)])
    levels = np.linspace(0, HEIGHT, rings)
    side = np.concatenate([np.column_stack([circle, np.full(sides, z)]) for z in levels])
    vertices = np.concatenate([side, [[0, 0, 0], [0, 0, HEIGHT]]])
    this = np.arange(sides)
    following = (this + 1) % sides
    faces = [np.column_stack([following, this, np.full(sides, len(side))])]
    for ring in range(rings - 1):
        low, high = ring * sides, (ring + 1) * sides
        faces.append(np.column_stack([low + this, low + following, high + this]))
        faces.append(np.column_stack([low + following, high + following, high + this]))
    top = (rings - 1) * sides
    faces.append(np.column_stack([top + this, top + following, np.full(sides, len(side) + 1)]))
    return vertices, np.concatenate(faces)


def halves(mesh: Mesh, border: float, values: tuple[int, int] = (1, 2)) -> SurfaceLabels:
    """The first label below z = border, fading linearly over 4 mm."""
    upper = np.clip(0.5 + (mesh.vertices[:, 2] - border) / 4, 0, 1)
    return SurfaceLabels(mesh.case_id, np.array(values), np.column_stack([1 - upper, upper]))


def cohort(
    borders: list[float], slip: float = 0.0
) -> tuple[CorrespondedShapes, list[Mesh], list[SurfaceLabels]]:
    """Equal cylinders with borders at these heights; the matches of the last slip along z."""
    vertices, faces = cylinder()
    ids = tuple(f"c{number}" for number in range(len(borders)))
    meshes = [Mesh(vertices, faces, case_id) for case_id in ids]
    points = np.stack([vertices] * len(borders))
    points[-1, :, 2] = np.clip(points[-1, :, 2] + slip, 0, HEIGHT)
    labels = [halves(mesh, border) for mesh, border in zip(meshes, borders, strict=True)]
    return CorrespondedShapes(points, faces, ids, ids[0]), meshes, labels


def scored(borders: list[float], slip: float = 0.0, points: int = 20_000) -> pd.DataFrame:
    shapes, meshes, labels = cohort(borders, slip)
    return carried_labels(shapes, meshes, labels, points, np.random.default_rng(0))


def test_equal_labels_and_perfect_matches_disagree_nowhere() -> None:
    table = scored([30.0, 30.0, 30.0])
    assert len(table) == 6
    assert (table["from_case_id"] != table["case_id"]).all()
    assert (table[["disagree_percent", "border_mm"]] == 0).all(axis=None)


@pytest.mark.parametrize("shift", [0.5, 2.0, 7.0])
def test_a_border_elsewhere_is_misplaced_by_as_much(shift: float) -> None:
    table = scored([30.0, 30.0 + shift])
    vertices, faces = cylinder()
    band = 2 * np.pi * RADIUS * shift / area(vertices, faces)
    rel = 3 / np.sqrt(20_000 * band)  # of so many samples, three standard errors
    assert table["border_mm"].to_numpy() == pytest.approx(shift, rel=rel)
    assert table["disagree_percent"].to_numpy() == pytest.approx(100 * band, rel=rel)


def test_a_slip_of_the_matches_is_found_where_labels_agree() -> None:
    table = scored([30.0, 30.0, 30.0], slip=3.0).set_index(["from_case_id", "case_id"])
    assert table.loc[("c0", "c2"), "border_mm"] == pytest.approx(3, rel=0.05)
    assert table.loc[("c2", "c0"), "border_mm"] == pytest.approx(3, rel=0.05)
    assert table.loc[("c0", "c1"), "border_mm"] == 0


def test_a_slip_that_undoes_the_shift_is_no_error() -> None:
    table = scored([30.0, 33.0], slip=3.0)
    # Within a part of the 1.5 mm between rings.
    assert table["border_mm"].max() < 0.1


def test_length_of_a_border_around_and_of_two() -> None:
    vertices, faces = cylinder()
    mesh = Mesh(vertices, faces, "c")
    around = 48 * 2 * RADIUS * np.sin(np.pi / 48)  # of the polygon
    assert border_length(vertices, faces, halves(mesh, 30.2).shares) == pytest.approx(around)
    z = vertices[:, 2]
    parts = np.column_stack([20 - z, np.full(len(z), 0.0), z - 40.0])  # borders at 20 and 40 mm
    assert border_length(vertices, faces, parts) == pytest.approx(2 * around)
    assert border_length(vertices, faces, np.ones((len(z), 1))) == 0


def test_labels_that_a_case_lacks() -> None:
    shapes, meshes, labels = cohort([30.0, 30.0])
    whole = SurfaceLabels("c1", np.array([2]), np.ones((len(meshes[1].vertices), 1)))
    table = carried_labels(shapes, meshes, [labels[0], whole], 5000, np.random.default_rng(0))
    assert table["disagree_percent"].to_numpy() == pytest.approx(50, abs=1)
    assert np.isnan(table.set_index("case_id").loc["c1", "border_mm"])


def test_means_and_differences_over_pairs() -> None:
    good, bad = scored([30.0, 30.0, 30.0, 32.0]), scored([30.0, 30.0, 30.0, 32.0], slip=-2.0)
    table = label_means({"full": good, "other": bad}, "full", 500, np.random.default_rng(0))
    rows = table.set_index("method")
    assert rows.loc["full", "border_mm"] == pytest.approx(good["border_mm"].mean())
    assert rows.loc["full", "border_difference_mm"] == 0
    # Half of the 12 pairs have the fourth case at an end: there 4 mm instead of 2.
    assert rows.loc["other", "border_difference_mm"] == pytest.approx(1.0, rel=0.05)
    assert rows.loc["other", "border_low_mm"] < rows.loc["other", "border_mm"]
    assert rows.loc["other", "border_high_mm"] > rows.loc["other", "border_mm"]
    cases = label_cases(good).set_index("case_id")
    assert cases.loc["c3", "border_mm"] == pytest.approx(2, rel=0.05)
    assert cases.loc["c0", "border_mm"] == pytest.approx(2 / 3, rel=0.05)


def test_pairs_lie_from_row_to_column() -> None:
    matrix = as_matrix(
        pd.DataFrame({"from_case_id": ["a"], "case_id": ["b"], "x": [5.0]}), "x", ["a", "b"]
    )
    assert matrix[0, 1] == 5
    assert np.isnan(matrix[[0, 1, 1], [0, 0, 1]]).all()


def test_the_interval_covers_the_mean_as_often_as_it_says() -> None:
    """Pairs that share a case's own effect: independent pairs would be covered far too seldom."""
    generator, covered, trials, count = np.random.default_rng(5), 0, 200, 25
    for _ in range(trials):
        effect = generator.standard_normal(count)
        pairs = effect[:, None] + effect[None] + 0.3 * generator.standard_normal((count, count))
        cases = [str(case) for case in range(count)]
        interval = pair_interval(pairs, resampled_cases(cases, 300, generator))
        covered += interval.low <= 0 <= interval.high
    # 95 % of 200 with a standard error of 1.6 %; the percentile bootstrap falls a little short.
    assert 0.87 < covered / trials <= 1


def test_pairs_without_a_value_are_left_out() -> None:
    pairs = np.array([[9.0, 1, np.nan], [3, 9, 5], [np.nan, np.nan, 9]])
    assert pair_interval(pairs, np.ones((1, 3))).mean == 3
    assert np.isnan(pair_interval(np.full((2, 2), np.nan), np.ones((1, 2))).mean)

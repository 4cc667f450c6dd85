"""The methods at a glance: order, traits, verdicts, tolerance of what is missing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest
from synthetic_report import make_cohort

from ssm_pipeline.report.method_table import (
    MethodTable,
    method_tables,
    method_traits,
    without_shown,
)


def comparison(**columns: list[Any]) -> dict[str, pd.DataFrame]:
    return {"comparison": pd.DataFrame({"method": ["full", "bcpd", "S3M"], **columns})}


def first(metrics: dict[str, pd.DataFrame]) -> MethodTable:
    table, _ = method_tables(metrics)
    assert table is not None
    return table


def further(metrics: dict[str, pd.DataFrame]) -> MethodTable:
    _, table = method_tables(metrics)
    assert table is not None
    return table


def differences(low: float, high: float, p: float | None = None) -> dict[str, list[Any]]:
    found = {
        "generalisation_surface_mm": [1.0, 1.1, 1.2],
        "generalisation_surface_difference_mm": [0.0, (low + high) / 2, 0.2],
        "generalisation_surface_low_mm": [0.0, low, 0.1],
        "generalisation_surface_high_mm": [0.0, high, 0.3],
    }
    return found if p is None else found | {"generalisation_surface_p": [np.nan, p, 0.01]}


@pytest.mark.parametrize(
    ("low", "high", "p", "verdict"),
    [
        (0.01, 0.1, None, "worse"),
        (-0.1, -0.01, None, "better"),
        (-0.01, 0.1, None, "alike"),
        (0.01, 0.1, 0.2, "alike"),  # after Holm's correction no longer
        (-0.1, -0.01, 0.04, "better"),
    ],
)
def test_a_verdict_needs_the_interval_and_the_adjusted_p(
    low: float, high: float, p: Any, verdict: str
) -> None:
    table = first(comparison(**differences(low, high, p)))
    (difference,) = [c.difference for row in table.rows if row.method == "bcpd" for c in row.cells]
    assert difference is not None
    assert difference.verdict == verdict
    assert difference.verdict in difference.label


@pytest.mark.parametrize(
    ("low", "high", "shown"),
    [
        (0.0001, 0.0095, "+0.0048 worse"),
        (-0.0095, -0.0001, "−0.0048 better"),
        (-0.001, 0.0106, "0.00 alike"),
        (0.1, 0.3, "+0.20 worse"),
    ],
)
def test_a_clear_difference_is_never_shown_as_zero(low: float, high: float, shown: str) -> None:
    table = first(comparison(**differences(low, high)))
    (difference,) = [c.difference for row in table.rows if row.method == "bcpd" for c in row.cells]
    assert difference is not None
    assert f"{difference.shown} {difference.verdict}" == shown
    if low == 0.0001:
        assert difference.label == "0.00480 (0.00010 to 0.00950): worse"


def test_a_method_without_a_difference_says_why() -> None:
    columns = differences(0.1, 0.3)
    columns["generalisation_surface_difference_mm"][1] = np.nan
    table = first(comparison(**columns))
    (bcpd,) = [row for row in table.rows if row.method == "bcpd"]
    assert bcpd.cells[0].missing
    assert table.has_missing
    assert not first(comparison(**differences(0.1, 0.3))).has_missing


def test_specificity_without_differences_has_no_empty_column() -> None:
    specific = {
        "specificity_surface_mm": [2.0, 2.1, 2.2],
        "specificity_surface_difference_mm": [0.0, np.nan, np.nan],
        "specificity_surface_low_mm": [0.0, np.nan, np.nan],
        "specificity_surface_high_mm": [0.0, np.nan, np.nan],
    }
    table = first(comparison(**differences(0.1, 0.3), **specific))
    assert [m.has_difference for m in table.measures] == [True, False]
    assert table.lacks_specificity
    assert not first(make_cohort(60, 6).metrics).lacks_specificity


def test_places_on_the_axis_are_those_of_the_values() -> None:
    table = first(comparison(**differences(0.1, 0.3)))
    reach = float(table.measures[0].axis)
    (_, bcpd, _) = [row.cells[0].difference for row in table.rows]
    assert bcpd is not None
    assert bcpd.at_low == pytest.approx(50 + 50 * 0.1 / reach)
    assert bcpd.at == pytest.approx(50 + 50 * 0.2 / reach)
    assert bcpd.at_high == pytest.approx(50 + 50 * 0.3 / reach)


def test_best_generalisation_comes_first() -> None:
    table = first(comparison(generalisation_surface_mm=[1.2, 1.0, 1.1]))
    assert [row.method for row in table.rows] == ["bcpd", "S3M", "full"]
    assert not table.measures[0].has_difference


def test_a_comparison_of_names_alone_is_shown() -> None:
    table = first(comparison())
    assert [row.cells for row in table.rows] == [(), (), ()]
    assert method_tables({}) == (None, None)
    assert method_tables(comparison())[1] is None


def test_traits_come_from_the_tables_and_else_from_the_names() -> None:
    scores = pd.DataFrame(
        {"method": ["full", "full", "adaptation only"], "matching_saw_case": [True, True, False]}
    )
    assert method_traits({"generalisation": scores, **comparison()}) == {
        "full": (True, True),
        "adaptation only": (False, False),
        "bcpd": (None, None),  # a name that is not ours
        "S3M": (True, None),
    }
    without = method_traits(comparison(), has_network=False)
    assert without["full"] == (False, None)
    assert without["S3M"] == (True, None)  # it brings its own
    told = comparison(uses_network=[True, False, True])
    assert method_traits(told)["bcpd"] == (False, None)


def test_with_three_intervals_p_is_on_hover() -> None:
    metrics = make_cohort(60, 6).metrics
    table = first(metrics)
    assert [m.has_difference for m in table.measures] == [True] * 3
    assert (table.has_p, table.shows_p) == (True, False)
    unseen = [name for name in metrics["comparison"] if name.startswith("unseen_")]
    assert first({"comparison": metrics["comparison"].drop(columns=unseen)}).shows_p


def test_labels_join_the_comparison_by_method() -> None:
    labels = pd.DataFrame(
        {
            "method": ["S3M", "full"],
            "border_mm": [14.0, 13.0],
            "border_difference_mm": [1.0, 0.0],
            "border_difference_low_mm": [0.5, 0.0],
            "border_difference_high_mm": [1.5, 0.0],
        }
    )
    table = further(comparison(generalisation_surface_mm=[1, 2, 3]) | {"labels_mean": labels})
    shown = {row.method: row.cells[0] for row in table.rows}
    assert (shown["full"].shown, shown["full"].difference) == ("13.00", None)
    assert shown["bcpd"].shown == "–"
    assert shown["S3M"].shown == "14.00"
    assert shown["S3M"].difference is not None
    assert shown["S3M"].difference.verdict == "worse"


def test_the_floor_of_the_chamfer_distance_is_a_row() -> None:
    metrics = make_cohort(60, 6).metrics
    floor = further(metrics).rows[-1]
    assert floor.kind == "floor"
    measures = [f"{m.title} {m.subtitle}" for m in further(metrics).measures]
    shown = dict(zip(measures, floor.cells, strict=True))
    assert shown["Generalisation Chamfer, mm"].shown == "1.93"
    assert shown["Generalisation 95th percentile, mm"].saved == ("", "")
    assert all(row.kind != "floor" for row in first(metrics).rows)


def test_what_the_tables_of_methods_show_is_not_told_again() -> None:
    table = make_cohort(60, 6).metrics["comparison"].assign(generalisation_chamfer_curve_mm=3.0)
    assert list(without_shown(table)) == [
        "method", "modes", "cases", "points", "specificity_hd95_mm", "specificity_hd95_se_mm",
        "generalisation_chamfer_curve_mm",
    ]  # fmt: skip
    assert without_shown(pd.DataFrame({"method": ["full"], "modes": [3]})).empty

import numpy as np
import pandas as pd
import pytest

from ssm_pipeline.evaluation.comparison import compare, modes_holding
from ssm_pipeline.records import Metrics


def metrics(offset: float, case_ids: str = "abcd", points: int = 100) -> Metrics:
    """Two numbers of modes; case i scores 1 + i + offset with one mode, half of it with two."""
    rows = [
        {
            "case_id": case_id,
            "modes": modes,
            "chamfer_mm": (1 + index + offset) / modes,
            "surface_mm": 0.5,
            "hd95_mm": 1.0,
            "correspondence_mm": 2.0,
            "points": points,
        }
        for modes in (1, 2)
        for index, case_id in enumerate(case_ids)
    ]
    drawn = pd.DataFrame({"modes": [1, 2]})
    for name in ("chamfer", "surface", "hd95"):
        drawn[f"{name}_mm"] = [4.0 + offset, 5.0 + offset]
        drawn[f"{name}_se_mm"] = 0.1
    shares = pd.DataFrame(
        {"modes": [1, 2], "share": [0.6, 1.0], "variance_per_point_mm2": [6.0, 4.0]}
    )
    tables = {"generalisation": pd.DataFrame(rows), "specificity": drawn, "compactness": shares}
    return Metrics(tables)


def test_table_by_hand() -> None:
    table = compare(
        {"ours": metrics(-0.5), "base": metrics(0)}, "base", 1000, np.random.default_rng(0)
    ).set_index("method")
    assert table.loc["base", "modes"] == 2
    assert table.loc["base", "generalisation_chamfer_mm"] == pytest.approx(1.25)
    error = np.std([0.5, 1, 1.5, 2], ddof=1) / 2
    assert table.loc["base", "generalisation_chamfer_se_mm"] == pytest.approx(error)
    assert table.loc["base", "generalisation_chamfer_curve_mm"] == pytest.approx((2.5 + 1.25) / 2)
    assert table.loc["ours", "specificity_chamfer_mm"] == 4.5
    assert table.loc["ours", "variance_mm2"] == 10
    # Every case is better by 0.25 mm: no resampling can say anything else.
    for part in ("difference", "low", "high"):
        assert table.loc["ours", f"generalisation_chamfer_{part}_mm"] == pytest.approx(-0.25)
        assert table.loc["base", f"generalisation_chamfer_{part}_mm"] == 0
    assert table.loc["ours", "generalisation_chamfer_p"] == pytest.approx(2 / 1001)
    assert np.isnan(table.loc["base", "generalisation_chamfer_p"])
    # Nothing was drawn without each case, so no interval of specificity is claimed.
    assert np.isnan(table.loc["ours", "specificity_surface_difference_mm"])


def with_draws(metrics: Metrics, shift: float) -> Metrics:
    """Draws at 5 mm and models without each case, both moved by `shift`."""
    noise = np.random.default_rng(3).normal(0, 0.4, 50)
    effect = np.random.default_rng(4).normal(0, 0.1, 4)
    draws = pd.DataFrame({"modes": 2, "draw": range(50), "surface_mm": 5 + noise + shift})
    jackknife = pd.DataFrame(
        [
            {"left_out": case, "modes": 2, "half": half, "surface_mm": 5 + e + shift}
            for case, e in zip("abcd", effect, strict=True)
            for half in (0, 1)
        ]
    )
    own = {"specificity_draws": draws, "specificity_jackknife": jackknife}
    return Metrics(metrics.tables | own)


def test_specificity_is_compared_draw_by_draw() -> None:
    methods = {
        name: with_draws(metrics(0), shift)
        for name, shift in (("base", 0.0), ("same", 0.0), ("worse", 0.3))
    }
    table = compare(methods, "base", 100, np.random.default_rng(0)).set_index("method")
    # The same draws of the same cases, all moved alike: the difference is known without doubt.
    for part in ("difference", "low", "high"):
        column = f"specificity_surface_{part}_mm"
        assert table.loc["worse", column] == pytest.approx(0.3)
        assert table.loc["same", column] == pytest.approx(0.0)
    assert table.loc["same", "specificity_surface_p"] == pytest.approx(1)
    assert table.loc["worse", "specificity_surface_p"] < 1e-6


def test_methods_scored_differently_are_refused() -> None:
    generator = np.random.default_rng(0)
    with pytest.raises(ValueError, match="different numbers of points"):
        compare({"a": metrics(0), "b": metrics(0, points=50)}, "a", 100, generator)
    with pytest.raises(ValueError, match="different cases"):
        compare({"a": metrics(0), "b": metrics(0, "abc")}, "a", 100, generator)
    with pytest.raises(ValueError, match="the baseline 'c'"):
        compare({"a": metrics(0)}, "c", 100, generator)
    with pytest.raises(ValueError, match="no row has 7 modes"):
        compare({"a": metrics(0)}, "a", 100, generator, modes={"a": 7})


def test_each_method_at_its_own_number_of_modes() -> None:
    one_mode_holds, two_modes_hold = metrics(0), metrics(0)
    one_mode_holds.tables["compactness"] = pd.DataFrame(
        {"modes": [1, 2], "share": [0.97, 1], "variance_per_point_mm2": [9.7, 0.3]}
    )
    methods = {"compact": one_mode_holds, "other": two_modes_hold}
    modes = {name: modes_holding(found, 0.95) for name, found in methods.items()}
    assert modes == {"compact": 1, "other": 2}
    table = compare(methods, "other", 100, np.random.default_rng(0), modes)
    assert table["modes"].tolist() == [1, 2]
    assert table["variance_percent"].tolist() == pytest.approx([97, 100])
    # The mean of 1 … 4 mm with one mode, half of it with two.
    assert table["generalisation_chamfer_mm"].tolist() == pytest.approx([2.5, 1.25])
    assert table["generalisation_chamfer_difference_mm"].tolist() == pytest.approx([1.25, 0])


def test_a_number_of_modes_that_was_not_scored_is_not_replaced_silently() -> None:
    found = metrics(0)
    found.tables["generalisation"] = found.tables["generalisation"].query("modes == 2")
    found.tables["compactness"]["share"] = [0.97, 1.0]
    with pytest.raises(ValueError, match="1 modes hold 95%; scored were"):
        modes_holding(found, 0.95)


def test_modes_that_only_some_cases_were_scored_at_are_not_compared() -> None:
    """Folds of unlike size give models of unlike size; a mean needs every case."""
    partial = metrics(0)
    cases = partial.tables["generalisation"]
    partial.tables["generalisation"] = cases[(cases["modes"] == 1) | (cases["case_id"] != "d")]
    assert modes_holding(partial, 0.95) == 1  # 60 %: the most there is
    table = compare({"a": partial, "b": metrics(0)}, "b", 100, np.random.default_rng(0))
    assert table["modes"].tolist() == [1, 1]
    assert table["cases"].tolist() == [4, 4]

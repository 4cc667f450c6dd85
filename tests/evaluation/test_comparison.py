import numpy as np
import pandas as pd
import pytest

from ssm_pipeline.evaluation.comparison import (
    PAPER_LUNA16,
    compare,
    modes_holding,
    paired_difference,
)
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
    shares = pd.DataFrame({"modes": [1, 2], "share": [0.6, 1.0]})
    tables = {"generalisation": pd.DataFrame(rows), "specificity": drawn, "compactness": shares}
    return Metrics(tables)


def test_table_by_hand():
    table = compare(
        {"ours": metrics(-0.5), "base": metrics(0)}, "base", 1000, np.random.default_rng(0)
    ).set_index("method")
    assert table.loc["base", "modes"] == 2
    assert table.loc["base", "generalisation_chamfer_mm"] == pytest.approx(1.25)
    error = np.std([0.5, 1, 1.5, 2], ddof=1) / 2
    assert table.loc["base", "generalisation_chamfer_se_mm"] == pytest.approx(error)
    assert table.loc["base", "generalisation_chamfer_curve_mm"] == pytest.approx((2.5 + 1.25) / 2)
    assert table.loc["ours", "specificity_chamfer_mm"] == 4.5
    assert table.loc["ours", "specificity_lower_percent"] == pytest.approx(10)
    # Every case is better by 0.25 mm: no resampling can say anything else.
    for column in ("difference_mm", "difference_low_mm", "difference_high_mm"):
        assert table.loc["ours", column] == pytest.approx(-0.25)
        assert table.loc["base", column] == 0
    assert table.loc["ours", "lower_percent"] == pytest.approx(20)


def test_cases_are_paired_by_name_and_not_by_row():
    base, own = (metrics(0).tables["generalisation"] for _ in range(2))
    base = base[base["modes"] == 1]
    shuffled = own[own["modes"] == 1].sample(frac=1, random_state=1)
    result = paired_difference(shuffled, base, "chamfer_mm", 500, np.random.default_rng(0))
    assert result["difference_low_mm"] == result["difference_high_mm"] == 0


def test_interval_covers_the_truth_as_often_as_it_says():
    generator = np.random.default_rng(0)
    ids, covered = [str(i) for i in range(40)], 0
    base = pd.DataFrame({"case_id": ids, "x_mm": 5.0})
    for _ in range(200):
        own = base.assign(x_mm=5 + generator.normal(-0.3, 1, 40))
        interval = paired_difference(own, base, "x_mm", 400, generator)
        covered += interval["difference_low_mm"] <= -0.3 <= interval["difference_high_mm"]
    assert 0.88 <= covered / 200 <= 0.99  # 95 %; percentile intervals are a little narrow


def test_methods_scored_differently_are_refused():
    generator = np.random.default_rng(0)
    with pytest.raises(ValueError, match="different numbers of points"):
        compare({"a": metrics(0), "b": metrics(0, points=50)}, "a", 100, generator)
    with pytest.raises(ValueError, match="different cases"):
        compare({"a": metrics(0), "b": metrics(0, "abc")}, "a", 100, generator)
    with pytest.raises(ValueError, match="the baseline 'c'"):
        compare({"a": metrics(0)}, "c", 100, generator)
    with pytest.raises(ValueError, match="7 modes asked"):
        compare({"a": metrics(0)}, "a", 100, generator, modes={"a": 7})


def test_each_method_at_its_own_number_of_modes():
    one_mode_holds, two_modes_hold = metrics(0), metrics(0)
    one_mode_holds.tables["compactness"] = pd.DataFrame({"modes": [1, 2], "share": [0.97, 1]})
    methods = {"compact": one_mode_holds, "other": two_modes_hold}
    modes = {name: modes_holding(found, 0.95) for name, found in methods.items()}
    assert modes == {"compact": 1, "other": 2}
    table = compare(methods, "other", 100, np.random.default_rng(0), modes)
    assert table["modes"].tolist() == [1, 2]
    assert table["variance_percent"].tolist() == pytest.approx([97, 100])
    # The mean of 1 … 4 mm with one mode, half of it with two.
    assert table["generalisation_chamfer_mm"].tolist() == pytest.approx([2.5, 1.25])
    assert table["difference_mm"].tolist() == pytest.approx([1.25, 0])


def test_modes_that_only_some_cases_were_scored_at_are_not_compared():
    """Folds of unlike size give models of unlike size; a mean needs every case."""
    partial = metrics(0)
    cases = partial.tables["generalisation"]
    partial.tables["generalisation"] = cases[(cases["modes"] == 1) | (cases["case_id"] != "d")]
    assert modes_holding(partial, 0.95) == 1  # 60 %: the most there is
    table = compare({"a": partial, "b": metrics(0)}, "b", 100, np.random.default_rng(0))
    assert table["modes"].tolist() == [1, 1]
    assert table["cases"].tolist() == [4, 4]


def test_the_papers_improvement():
    generalisation, specificity = (
        PAPER_LUNA16[f"{name}_chamfer_mm"] for name in ("generalisation", "specificity")
    )
    assert 100 * (1 - generalisation[1] / generalisation[0]) == pytest.approx(16.4, abs=0.1)
    assert 100 * (1 - specificity[1] / specificity[0]) == pytest.approx(19.3, abs=0.1)

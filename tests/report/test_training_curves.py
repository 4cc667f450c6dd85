"""Training curves and the watch over the map, by known answers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest

from ssm_pipeline.report.training_curves import POINTS, collapse_warning, training_charts


def losses(steps: int = 1000, **columns: Any) -> pd.DataFrame:
    return pd.DataFrame({"step": np.arange(1, steps + 1), "total": 5.0, **columns})


def test_a_term_that_begins_later_has_no_line_before() -> None:
    arap = np.where(np.arange(1000) < 500, np.nan, 2.0)
    (chart,) = training_charts(losses(arap=arap))
    lines = {line["name"]: line for line in chart["lines"]}
    assert len(lines["total"]["x"]) == POINTS
    assert lines["total"]["x"][-1] == 1000
    assert 500 < lines["arap"]["x"][0] < 520
    assert set(lines["arap"]["y"]) == {2.0}
    # Read at one step, both lines have a value there.
    assert set(lines["arap"]["x"]) <= set(lines["total"]["x"])


def test_points_are_means_over_steps() -> None:
    (chart,) = training_charts(losses(steps=240, align=np.tile([1.0, 3.0], 120)))
    assert set(chart["lines"][1]["y"]) == {2.0}


def test_losses_that_reach_zero_or_below_have_a_plain_axis() -> None:
    assert training_charts(losses(align=1.0))[0]["log"]
    assert not training_charts(losses(variance=-1.0))[0]["log"]


def test_what_is_watched_has_charts_of_its_own() -> None:
    titles = [chart["title"] for chart in training_charts(losses(map_extent=0.9, share_hit=0.5))]
    assert titles == ["Losses", "Extent of the soft map", "Vertices hit"]
    assert training_charts(None) == []


@pytest.mark.parametrize(
    ("extent", "cosine", "told"),
    [(0.04, 0.1, "4 % of its target"), (0.99, 0.976, "mean cosine 0.98"), (0.99, 0.1, None)],
)
def test_a_collapsed_map_is_told(extent: float, cosine: float, told: Any) -> None:
    warning = collapse_warning(losses(map_extent=extent, mean_cosine=cosine))
    assert (warning is None) if told is None else (told in str(warning))


def test_only_the_end_of_the_training_is_judged() -> None:
    extent = np.where(np.arange(1000) < 850, 0.01, 0.98)
    assert collapse_warning(losses(map_extent=extent)) is None
    assert collapse_warning(losses()) is None  # nothing was watched

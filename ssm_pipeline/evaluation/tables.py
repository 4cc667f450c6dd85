"""The evaluation's tables of all methods together."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from ssm_pipeline.evaluation.comparison import (
    PAPER_LUNA16,
    compare,
    modes_holding,
    paired_difference,
)
from ssm_pipeline.evaluation.model_quality import mean_over_cases
from ssm_pipeline.methods import FULL, ONE_CASE_AT_A_TIME, RETRAINED
from ssm_pipeline.records import Metrics

GENERALISATION = ("generalisation", "generalisation_mean")


def together(scores: Mapping[str, Metrics]) -> dict[str, pd.DataFrame]:
    """The tables of all methods, one below the other, and of some the means over the cases.

    Generalisation says whether the matching knew the held-out case: its networks were trained on
    it too, or it is in the mean shape of the groupwise rounds.
    fit, truth_mean  a row a method: means of the tables correspondence and truth.
    """
    tables = {
        name: pd.concat(
            [metrics.tables[name] for metrics in scores.values() if name in metrics.tables],
            ignore_index=True,
        )
        for name in sorted({name for metrics in scores.values() for name in metrics.tables})
    }
    for name in GENERALISATION:
        # Without labels; and the shape model is always built without the case.
        saw_case = ~tables[name]["method"].isin(ONE_CASE_AT_A_TIME)
        tables[name].insert(1, "matching_saw_case", saw_case)
    for name, means in (("correspondence", "fit"), ("truth", "truth_mean")):
        if name in tables:
            cases = tables[name].drop(columns=["case_id", "seed"], errors="ignore")
            tables[means] = cases.groupby("method", sort=False).mean().reset_index()
    return tables


def comparisons(
    scores: Mapping[str, Metrics], bootstrap_draws: int, seed: int, with_paper: bool = False
) -> dict[str, pd.DataFrame]:
    """The methods side by side, against S3M where it is among them.

    comparison     the same number of modes for all.
    comparison_95  so many modes a method as hold 95 % of its own variance.
    paper          where asked for: the numbers published of LUNA16, on other data.
    """
    baseline = "S3M" if "S3M" in scores else FULL
    own_modes = {method: modes_holding(metrics, 0.95) for method, metrics in scores.items()}
    first, second = np.random.default_rng(seed).spawn(2)
    tables = {
        "comparison": compare(scores, baseline, bootstrap_draws, first),
        "comparison_95": compare(scores, baseline, bootstrap_draws, second, own_modes),
    }
    if with_paper:
        tables["paper"] = PAPER_LUNA16
    return tables


def with_variance_kept(tables: Mapping[str, pd.DataFrame]) -> dict[str, pd.DataFrame]:
    """The comparisons with the table `variance_kept` as a column before specificity.

    A method that draws all shapes together wins specificity: here it shows.
    """
    kept = tables["variance_kept"].set_index("method")["variance_kept_percent"]
    changed = {name: table for name, table in tables.items() if name != "variance_kept"}
    for name in ("comparison", "comparison_95"):
        table = tables[name].copy()
        place = table.columns.get_loc("specificity_chamfer_mm")
        assert isinstance(place, int)
        table.insert(place, "variance_kept_percent", table["method"].map(kept))
        changed[name] = table
    return changed


def with_retrained(
    tables: Mapping[str, pd.DataFrame],
    retrained: pd.DataFrame,
    bootstrap_draws: int,
    seed: int,
) -> dict[str, pd.DataFrame]:
    """The generalisation tables with the retrained folds below the methods, and a new one.

    retraining  one row: Chamfer generalisation at the most modes where the matcher has not seen
                the case and where it has, their difference by case and its 95 % interval.
    """
    mean = mean_over_cases(retrained).assign(method=RETRAINED, seed=seed)
    extended = {
        name: pd.concat(
            [tables[name], rows.assign(matching_saw_case=False)[list(tables[name].columns)]],
            ignore_index=True,
        )
        for name, rows in zip(GENERALISATION, (retrained, mean), strict=True)
    }
    modes = int(retrained["modes"].max())
    cases = extended["generalisation"]
    cases = cases[cases["modes"] == modes]
    without, with_case = (cases[cases["method"] == method] for method in (RETRAINED, FULL))
    generator = np.random.default_rng(seed)
    row = {
        "modes": modes,
        "cases": len(without),
        "case_unseen_chamfer_mm": without["chamfer_mm"].mean(),
        "case_seen_chamfer_mm": with_case["chamfer_mm"].mean(),
        **paired_difference(without, with_case, "chamfer_mm", bootstrap_draws, generator),
    }
    return extended | {"retraining": pd.DataFrame([row]).drop(columns="lower_percent")}

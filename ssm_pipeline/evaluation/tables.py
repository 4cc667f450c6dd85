"""The evaluation's tables of all methods together."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from ssm_pipeline.evaluation.comparison import PAPER_LUNA16, compare, modes_holding
from ssm_pipeline.evaluation.paired import holm, over_cases
from ssm_pipeline.methods import FULL, learns
from ssm_pipeline.records import Metrics

GENERALISATION = ("generalisation", "generalisation_mean")
# What intervals rest on: long, and kept in each method's folder only.
_PER_METHOD = ("specificity_draws", "specificity_jackknife")


def joined(scores: Mapping[str, Metrics]) -> dict[str, pd.DataFrame]:
    """The tables of all methods, one below the other, and of some the means over the cases.

    Generalisation says whether the matching knew the held-out case: its networks were trained on
    it too, or it is in the mean shape of the groupwise rounds.
    fit, truth_mean  a row per method: means of the tables correspondence and truth.
    """
    tables = {
        name: pd.concat(
            [metrics.tables[name] for metrics in scores.values() if name in metrics.tables],
            ignore_index=True,
        )
        for name in sorted({name for metrics in scores.values() for name in metrics.tables})
        if name not in _PER_METHOD
    }
    for name in GENERALISATION:
        # Without labels; and the shape model is always built without the case.
        saw_case = tables[name]["method"].map(learns)
        tables[name].insert(1, "matching_saw_case", saw_case)
    for name, means in (("correspondence", "fit"), ("truth", "truth_mean")):
        if name in tables:
            cases = tables[name].drop(columns=["case_id", "seed"], errors="ignore")
            tables[means] = cases.groupby("method", sort=False).mean().reset_index()
    return tables


def comparisons(
    scores: Mapping[str, Metrics], bootstrap_draws: int, seed: int, with_paper: bool = False
) -> dict[str, pd.DataFrame]:
    """The methods side by side, each against the full one.

    comparison     the same number of modes for all.
    comparison_95  so many modes a method as hold 95 % of its own variance.
    paper          where asked for: the numbers published of LUNA16, on other data.
    """
    own_modes = {method: modes_holding(metrics, 0.95) for method, metrics in scores.items()}
    first, second = np.random.default_rng(seed).spawn(2)
    tables = {
        "comparison": compare(scores, FULL, bootstrap_draws, first),
        "comparison_95": compare(scores, FULL, bootstrap_draws, second, own_modes),
    }
    tables["comparison"] = with_surface_fits(tables["comparison"], scores)
    if with_paper:
        tables["paper"] = PAPER_LUNA16
    return tables


def with_surface_fits(comparison: pd.DataFrame, scores: Mapping[str, Metrics]) -> pd.DataFrame:
    """The comparison with surface_fit_mm: models fitted to held-out surfaces, mean over the cases,
    with its standard error over them."""
    columns: dict[str, list[float]] = {"surface_fit_mm": [], "surface_fit_se_mm": []}
    for method in comparison["method"]:
        table = scores[method].tables.get("surface_fits")
        if table is None:
            return comparison
        columns["surface_fit_mm"].append(table["surface_mm"].mean())
        columns["surface_fit_se_mm"].append(table["surface_mm"].sem())
    return comparison.assign(**columns)


def with_variance_kept(tables: Mapping[str, pd.DataFrame]) -> dict[str, pd.DataFrame]:
    """The comparisons with the table `variance_kept` as a column before specificity.

    A method that draws all shapes together wins specificity: here it shows.
    """
    kept = tables["variance_kept"].set_index("method")["variance_kept_percent"]
    changed = {name: table for name, table in tables.items() if name != "variance_kept"}
    for name in ("comparison", "comparison_95"):
        table = tables[name].copy()
        place = table.columns.get_loc("specificity_surface_mm")
        assert isinstance(place, int)
        table.insert(place, "variance_kept_percent", table["method"].map(kept))
        changed[name] = table
    return changed


def with_unseen(
    tables: Mapping[str, pd.DataFrame],
    unseen: Mapping[str, pd.DataFrame],
    bootstrap_draws: int,
    seed: int,
) -> dict[str, pd.DataFrame]:
    """The tables, those of unseen cases, and the comparison with both columns.

    unseen  `unseen_generalisation` and `unseen_specificity` of the rows that learn. Of the others,
            which meet each case as if it were unseen, generalisation is taken from its own table.
    New columns of the comparison: unseen_generalisation_surface_mm, its standard error over the
    cases, the difference to the full method with interval and p as elsewhere, and
    unseen_specificity_surface_mm with seen_specificity_surface_mm beside it, both to the nearest of
    as many cases (`evaluation.unseen`), means over the folds.
    """
    learned = unseen["unseen_generalisation"]
    modes = int(learned["modes"].max())
    own = tables["generalisation"]
    others = own[~own["method"].map(learns)]
    cases = pd.concat([learned, others[learned.columns]], ignore_index=True)
    if "patient" in own:
        whose = own.drop_duplicates("case_id").set_index("case_id")["patient"]
        cases["patient"] = cases["case_id"].map(whose)
    at_modes = {method: t for method, t in cases[cases["modes"] == modes].groupby("method")}
    generator = np.random.default_rng(seed)
    rows = []
    for method in tables["comparison"]["method"]:
        row: dict[str, object] = {"method": method}
        found = at_modes.get(method)
        if found is not None:
            row["mm"], row["se_mm"] = found["surface_mm"].mean(), found["surface_mm"].sem()
            if method != FULL:
                difference = over_cases(
                    found, at_modes[FULL], "surface_mm", bootstrap_draws, generator
                )
                row |= {"difference_mm": difference.value, "p": difference.p}
                row |= {"low_mm": difference.low, "high_mm": difference.high}
            else:
                row |= dict.fromkeys(("difference_mm", "low_mm", "high_mm"), 0.0)
        rows.append(row)
    added = pd.DataFrame(rows).set_index("method")
    added["p"] = holm(added["p"].to_numpy()) if "p" in added else np.nan
    added = added.add_prefix("unseen_generalisation_surface_")
    drawn = unseen["unseen_specificity"].groupby("method")
    added["unseen_specificity_surface_mm"] = drawn["surface_mm"].mean()
    added["seen_specificity_surface_mm"] = drawn["seen_surface_mm"].mean()
    comparison = tables["comparison"].merge(added.reset_index(), on="method", how="left")
    return {**tables, **unseen, "comparison": comparison}

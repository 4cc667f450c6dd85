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
# The intervals are computed from these long tables, which stay in the folder of each method.
_PER_METHOD = ("specificity_draws", "specificity_jackknife")


def joined(scores: Mapping[str, Metrics]) -> dict[str, pd.DataFrame]:
    """The tables of all methods, one below the other.

    Generalisation gets a column matching_saw_case. It is true if the held-out case decided the
    matching, because networks were trained on it or because it is part of a groupwise mean.
    The tables fit and truth_mean have a row per method: the means of correspondence and truth.
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
        # Networks see a case without labels. The shape model never contains the held-out case.
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
    """The methods compared with the full one.

    Returns:
        comparison: With the same number of modes for all.
        comparison_95: With the number of modes that holds 95 % of each method's own variance.
        paper: With `with_paper`, the published numbers of LUNA16, which are of other data.
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
    """The comparison with the columns surface_fit_mm and surface_fit_se_mm.

    They are the mean and standard error over the cases of the distance from a held-out surface to
    the model that is fitted to it.
    """
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

    A method that makes all shapes more alike has a better specificity. This column reveals it.
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
    """The tables with those of unseen cases, and with the columns of unseen cases in comparison.

    The new columns of the comparison are unseen_generalisation_surface_mm with its standard error
    over the cases and the difference to the full method with interval and p; and
    unseen_specificity_surface_mm and seen_specificity_surface_mm, means over the folds of the
    distance to the nearest of equally many cases (`evaluation.unseen`).

    Args:
        unseen: `unseen_generalisation` and `unseen_specificity` of the methods that learn. To the
            other methods every case is unseen, so their ordinary generalisation is used.
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

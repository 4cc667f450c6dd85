"""Methods side by side: one row each, with paired differences to a baseline."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from ssm_pipeline.records import Metrics

# Cao et al. 2024 ("Spectral Meets Spatial", CVPR), statistical shape models of 22 left lungs of
# LUNA16, Chamfer distance. Other segmentations, meshes and samplings than a run of this project:
# numbers to stand beside, not to subtract from.
PAPER_LUNA16 = pd.DataFrame(
    {
        "method": ["S3M (as printed in the paper)", "Spectral Meets Spatial (the paper)"],
        "generalisation_chamfer_mm": [2.92, 2.44],
        "specificity_chamfer_mm": [6.23, 5.03],
        "source": ["Cao et al. 2024, other data"] * 2,
    }
)


def compare(
    methods: Mapping[str, Metrics],
    baseline: str,
    draws: int,
    generator: np.random.Generator,
    modes: Mapping[str, int] | None = None,
) -> pd.DataFrame:
    """One row a method: G(M) and S(M) with standard errors, and the difference to the baseline.

    methods   name → Metrics of `evaluate_method`, all of the same cases, points and seed.
    draws     bootstrap resamplings of the cases.
    modes     M of each method; by default the same for all, the most that every method has.

    Returns   method, modes, variance_percent (what M modes hold of the method's own variance),
              cases, points, then generalisation_<d>_mm, generalisation_<d>_se_mm,
              specificity_<d>_mm, specificity_<d>_se_mm for d = chamfer, surface, hd95;
              generalisation_correspondence_mm; the means over all numbers of modes
              generalisation_chamfer_curve_mm, specificity_chamfer_curve_mm; and, for the Chamfer
              generalisation against the baseline, difference_mm with its 95 % bootstrap interval
              difference_low_mm … difference_high_mm and lower_percent; specificity_lower_percent.
    Raises ValueError where methods were not scored alike.
    """
    if baseline not in methods:
        raise ValueError(f"the baseline {baseline!r} is none of {sorted(methods)}")
    _require_alike(methods)
    if modes is None:
        shared = set.intersection(*(set(_scored_modes(metrics)) for metrics in methods.values()))
        modes = dict.fromkeys(methods, max(shared))  # one mode, at least, is always scored
    rows = [_row(name, metrics, modes[name]) for name, metrics in methods.items()]
    reference = _at(methods[baseline].tables["generalisation"], modes[baseline])
    specificity = _at(methods[baseline].tables["specificity"], modes[baseline])["chamfer_mm"].item()
    for row, (name, metrics) in zip(rows, methods.items(), strict=True):
        cases = _at(metrics.tables["generalisation"], modes[name])
        row |= paired_difference(cases, reference, "chamfer_mm", draws, generator)
        row["specificity_lower_percent"] = 100 * (1 - row["specificity_chamfer_mm"] / specificity)
    return pd.DataFrame(rows)


def modes_holding(metrics: Metrics, share: float) -> int:
    """The fewest modes that hold a share (0 … 1) of the variance, of the numbers scored.

    Where no number scored holds so much (leaving a case out takes a mode away), the largest.
    """
    held = metrics.tables["compactness"].set_index("modes")["share"]
    scored = _scored_modes(metrics)
    return next((modes for modes in scored if held[modes] >= share), scored[-1])


def paired_difference(
    cases: pd.DataFrame,
    baseline: pd.DataFrame,
    column: str,
    draws: int,
    generator: np.random.Generator,
) -> dict[str, float]:
    """Mean difference over the cases (method − baseline) with its 95 % bootstrap interval.

    cases, baseline  tables a row per case; compared case by case, by case_id.
    Source: percentile bootstrap over cases, Efron 1979.
    """
    own, other = (table.set_index("case_id")[column] for table in (cases, baseline))
    difference = (own - other.loc[own.index]).to_numpy()
    picks = generator.integers(len(difference), size=(draws, len(difference)))
    low, high = np.percentile(difference[picks].mean(axis=1), [2.5, 97.5])
    return {
        "difference_mm": float(difference.mean()),
        "difference_low_mm": float(low),
        "difference_high_mm": float(high),
        "lower_percent": float(100 * (1 - own.mean() / other.mean())),
    }


def _row(name: str, metrics: Metrics, modes: int) -> dict[str, Any]:
    cases = _at(metrics.tables["generalisation"], modes)
    drawn = _at(metrics.tables["specificity"], modes)
    held = _at(metrics.tables["compactness"], modes)["share"].item()
    row: dict[str, Any] = {
        "method": name,
        "modes": modes,
        "variance_percent": 100 * held,
        "cases": len(cases),
        "points": int(cases["points"].iloc[0]),
    }
    for distance in ("chamfer", "surface", "hd95"):
        row |= {
            f"generalisation_{distance}_mm": cases[f"{distance}_mm"].mean(),
            f"generalisation_{distance}_se_mm": cases[f"{distance}_mm"].sem(),
            f"specificity_{distance}_mm": drawn[f"{distance}_mm"].item(),
            f"specificity_{distance}_se_mm": drawn[f"{distance}_se_mm"].item(),
        }
    row["generalisation_correspondence_mm"] = cases["correspondence_mm"].mean()
    for table in ("generalisation", "specificity"):
        curve = metrics.tables[table]
        row[f"{table}_chamfer_curve_mm"] = curve.groupby("modes")["chamfer_mm"].mean().mean()
    return row


def _scored_modes(metrics: Metrics) -> list[int]:
    """The numbers of modes, ascending, at which every case and the draws were scored."""
    cases = metrics.tables["generalisation"]
    counts = cases.groupby("modes").size()
    complete = set(counts.index[counts == cases["case_id"].nunique()])
    return sorted(int(modes) for modes in complete & set(metrics.tables["specificity"]["modes"]))


def _at(table: pd.DataFrame, modes: int) -> pd.DataFrame:
    found = table[table["modes"] == modes]
    if found.empty:
        raise ValueError(f"{modes} modes asked; the table has {sorted(table['modes'].unique())}")
    return found


def _require_alike(methods: Mapping[str, Metrics]) -> None:
    """Same cases, and the same number of points: the Chamfer floor depends on it."""
    scored = {
        name: (
            frozenset(metrics.tables["generalisation"]["case_id"]),
            frozenset(metrics.tables["generalisation"]["points"]),
        )
        for name, metrics in methods.items()
    }
    if len({points for _, points in scored.values()}) > 1:
        found = {name: sorted(points) for name, (_, points) in scored.items()}
        raise ValueError(
            f"the methods were scored with different numbers of points: {found}. Set `points` of "
            "the evaluation to the smallest, for all."
        )
    if len({cases for cases, _ in scored.values()}) > 1:
        counts = {name: len(cases) for name, (cases, _) in scored.items()}
        raise ValueError(
            f"the methods were scored on different cases (counts: {counts}). Evaluate all of them "
            "on the cases that every method has."
        )

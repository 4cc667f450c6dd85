"""A row per method, with paired differences to a baseline."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from ssm_pipeline.evaluation.paired import (
    PairedDifference,
    holm,
    over_cases,
    over_left_out_cases,
)
from ssm_pipeline.records import Metrics

# Cao et al. 2024 ("Spectral Meets Spatial", CVPR), statistical shape models of 22 left lungs of
# LUNA16, Chamfer distance. Segmentations, meshes and samplings differ from those of this project:
# these numbers can be shown beside ours, but differences between them have no meaning.
PAPER_LUNA16 = pd.DataFrame(
    {
        "method": ["S3M (as printed in the paper)", "Spectral Meets Spatial (the paper)"],
        "generalisation_chamfer_mm": [2.92, 2.44],
        "specificity_chamfer_mm": [6.23, 5.03],
        "source": ["Cao et al. 2024, other data"] * 2,
    }
)


DISTANCES = ("surface", "chamfer", "hd95")
# The measures and distances that are compared with the baseline.
COMPARED = (
    ("generalisation", "surface"),
    ("specificity", "surface"),
    ("generalisation", "chamfer"),
)


def compare(
    methods: Mapping[str, Metrics],
    baseline: str,
    draws: int,
    generator: np.random.Generator,
    modes: Mapping[str, int] | None = None,
) -> pd.DataFrame:
    """A row per method: G(M) and S(M) with standard errors, and the difference to the baseline.

    Args:
        methods: Name → Metrics of `evaluate_method`, all with the same cases, points and seed.
        baseline: The name of the method that the others are compared with.
        draws: Bootstrap resamplings of the cases.
        modes: M of each method. By default the same for all: the most that every method has.

    Returns:
        method, modes, variance_percent (the share of the method's own variance that M modes hold),
        variance_mm2 (of all its modes: the mean over the points of the squared distance from the
        mean), cases, points; <measure>_<d>_mm and <measure>_<d>_se_mm for generalisation and
        specificity and d = surface, chamfer, hd95; generalisation_correspondence_mm; and the means
        over all numbers of modes, generalisation_chamfer_curve_mm and specificity_chamfer_curve_mm.
        For each pair in `COMPARED`, also the difference to the baseline on the same cases,
        <measure>_<d>_difference_mm, its 95 % interval <measure>_<d>_low_mm … <measure>_<d>_high_mm,
        and <measure>_<d>_p with Holm's correction for the number of methods (`evaluation.paired`).
        They are NaN where they were not measured.

    Raises:
        ValueError: The baseline is missing, or the methods were not scored in the same way.
    """
    if baseline not in methods:
        raise ValueError(f"the baseline {baseline!r} is not among {sorted(methods)}")
    _require_alike(methods)
    if modes is None:
        shared = set.intersection(*(set(_scored_modes(metrics)) for metrics in methods.values()))
        modes = dict.fromkeys(methods, max(shared))  # at least one mode is always scored
    table = pd.DataFrame([_row(name, metrics, modes[name]) for name, metrics in methods.items()])
    for measure, distance in COMPARED:
        found = [
            None
            if name == baseline
            else _difference(
                measure,
                distance,
                (metrics, modes[name]),
                (methods[baseline], modes[baseline]),
                draws,
                generator,
            )
            for name, metrics in methods.items()
        ]
        column = f"{measure}_{distance}"
        for part, field in (("difference", "value"), ("low", "low"), ("high", "high")):
            table[f"{column}_{part}_mm"] = [
                0.0 if name == baseline else np.nan if d is None else getattr(d, field)
                for name, d in zip(methods, found, strict=True)
            ]
        table[f"{column}_p"] = holm([np.nan if d is None else d.p for d in found])
    return table


def modes_holding(metrics: Metrics, share: float) -> int:
    """The fewest modes that hold a share (0 … 1) of the variance.

    If a model without one case has fewer modes, this is the largest number that was scored.

    Raises:
        ValueError: This number of modes was not scored (`evaluate_method` scores that of 95 %).
    """
    held = metrics.tables["compactness"].set_index("modes")["share"]
    wanted = int(held.index[held >= share - 1e-12][0])
    scored = _scored_modes(metrics)
    if wanted not in scored and wanted < scored[-1]:
        raise ValueError(f"{wanted} modes hold {share:.0%}; scored were {scored}")
    return min(wanted, scored[-1])


def _difference(
    measure: str,
    distance: str,
    own: tuple[Metrics, int],
    baseline: tuple[Metrics, int],
    draws: int,
    generator: np.random.Generator,
) -> PairedDifference | None:
    """The difference between two methods, each with its number of modes; None if not measured."""
    if measure == "generalisation":
        cases, others = (_at(m.tables["generalisation"], modes) for m, modes in (own, baseline))
        return over_cases(cases, others, f"{distance}_mm", draws, generator)
    left_out: list[pd.DataFrame] = []
    drawn: list[pd.DataFrame] = []
    for metrics, modes in (own, baseline):
        for name, found in (("specificity_jackknife", left_out), ("specificity_draws", drawn)):
            table = metrics.tables.get(name)
            table = None if table is None else table[table["modes"] == modes]
            if table is None or table.empty:
                return None
            found.append(table)
    pair = [table.sort_values("draw")[f"{distance}_mm"].to_numpy() for table in drawn]
    return over_left_out_cases(left_out[0], left_out[1], pair[0], pair[1])


def _row(name: str, metrics: Metrics, modes: int) -> dict[str, Any]:
    cases = _at(metrics.tables["generalisation"], modes)
    drawn = _at(metrics.tables["specificity"], modes)
    held = _at(metrics.tables["compactness"], modes)["share"].item()
    row: dict[str, Any] = {
        "method": name,
        "modes": modes,
        "variance_percent": 100 * held,
        "variance_mm2": metrics.tables["compactness"]["variance_per_point_mm2"].sum(),
        "cases": len(cases),
        "points": int(cases["points"].iloc[0]),
    }
    for distance in DISTANCES:
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
        raise ValueError(f"no row has {modes} modes, only {sorted(table['modes'].unique())}")
    return found


def _require_alike(methods: Mapping[str, Metrics]) -> None:
    """Raise ValueError unless all methods have the same cases and the same number of points.

    The smallest possible Chamfer distance depends on the number of points.
    """
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

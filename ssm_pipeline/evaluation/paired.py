"""Differences between two methods on the same cases, with what other cases would have given.

Patients, not draws, are the sample: a cohort of others is what a reader asks about. Where each has
one case, the cases are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats

AT_A_TIME = 10_000_000  # cases drawn by a bootstrap: all at once are GB for a cohort of thousands


@dataclass(frozen=True)
class PairedDifference:
    """Mean difference (method − baseline, mm), its 95 % interval, and the two-sided p of no
    difference, not yet corrected for the number of methods."""

    value: float
    low: float
    high: float
    p: float


def over_cases(
    cases: pd.DataFrame,
    baseline: pd.DataFrame,
    column: str,
    draws: int,
    generator: np.random.Generator,
) -> PairedDifference:
    """Of a column with a value per case (generalisation): paired bootstrap over the cases.

    Args:
        cases, baseline: Tables with a row per case; paired by case_id. A column patient, where one
            has several cases: they are drawn together.
        draws: Resamplings. The p is twice the smaller share of resampled means on either side of 0,
            at least 2 / (draws + 1).

    Source: percentile bootstrap, Efron 1979; p: Davison and Hinkley 1997, 4.4.
    """
    own, other = (table.set_index("case_id")[column] for table in (cases, baseline))
    difference = own - other.loc[own.index]
    patients = cases.get("patient", cases["case_id"]).to_numpy()
    of_patients = difference.groupby(patients, sort=False)
    sums, sizes = of_patients.sum().to_numpy(), of_patients.size().to_numpy()
    count = len(sums)
    drawn = (
        generator.integers(count, size=(part, count))
        for part in _parts(draws, max(1, AT_A_TIME // count))
    )
    means = np.concatenate([sums[each].sum(axis=1) / sizes[each].sum(axis=1) for each in drawn])
    low, high = np.percentile(means, [2.5, 97.5])
    beyond = min((means <= 0).sum(), (means >= 0).sum())
    p = min(1.0, 2 * (beyond + 1) / (draws + 1))
    return PairedDifference(float(difference.mean()), float(low), float(high), float(p))


def _parts(total: int, most: int) -> list[int]:
    """Numbers that add up to the total, none above the most."""
    return [min(most, total - begun) for begun in range(0, total, most)]


def over_left_out_cases(
    left_out: pd.DataFrame,
    baseline_left_out: pd.DataFrame,
    drawn: np.ndarray,
    baseline_drawn: np.ndarray,
) -> PairedDifference:
    """Of the mean over a model's draws (specificity): delete-one jackknife over the cases.

    Leaving out case i (all cases of patient i) changes the difference by θ_i; the variance over
    cohorts is (N − 1)/N Σ (θ_i − θ̄)². Each θ_i carries the noise of its draws, which would be
    counted N times: one factor from each half of the draws leaves it out in expectation (a negative
    estimate is 0). The noise of the draws of the whole models is then added once. Interval and p by
    Student's t with N − 1 degrees of freedom.

    Args:
        left_out, baseline_left_out: As `specificity_jackknife.without_each` gives them: for each
            case, or patient, the means of two halves of draws of a model built without it.
        drawn, baseline_drawn: (n,) mm: the draws of the whole cohort's models, in the same order.
            Both methods' draws are made of the same weights of the same cases, so they pair.

    Source: Efron and Stein 1981 for the jackknife.
    """
    halves = [
        table.pivot(index="left_out", columns="half", values="surface_mm").to_numpy()
        for table in (left_out, baseline_left_out)
    ]
    effect = halves[0] - halves[1]  # (N, 2)
    count = len(effect)
    effect = effect - effect.mean(axis=0)
    of_cases = (count - 1) / count * float((effect[:, 0] * effect[:, 1]).sum())
    difference = drawn - baseline_drawn
    of_draws = float(difference.var(ddof=1)) / len(difference)
    error = np.sqrt(max(of_cases, 0.0) + of_draws)
    value, reach = float(difference.mean()), float(stats.t.ppf(0.975, count - 1) * error)
    p = float(2 * stats.t.sf(abs(value) / error, count - 1)) if error > 0 else float(value == 0)
    return PairedDifference(value, value - reach, value + reach, p)


def holm(p_values: Sequence[float]) -> np.ndarray:
    """p-values corrected for their number, so that all of them together err once in twenty times.

    NaN stays NaN and does not count. Source: Holm 1979.

    >>> holm([0.01, 0.04, 0.03]).round(3).tolist()
    [0.03, 0.06, 0.06]
    """
    p = np.asarray(p_values, dtype=np.float64)
    corrected = np.full(len(p), np.nan)
    there = np.flatnonzero(np.isfinite(p))
    order = there[np.argsort(p[there], kind="stable")]
    steps = p[order] * np.arange(len(order), 0, -1)
    corrected[order] = np.minimum(np.maximum.accumulate(steps), 1.0) if len(order) else []
    return corrected

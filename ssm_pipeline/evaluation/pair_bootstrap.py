"""Means over ordered pairs of cases, with intervals over the cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd


@dataclass(frozen=True)
class Interval:
    """A mean and its 95 % bootstrap interval."""

    mean: float
    low: float
    high: float


def resampled_cases(
    patients: Sequence[str], draws: int, generator: np.random.Generator
) -> np.ndarray:
    """(draws, N) how often each case is in each resampling; the same for all that compare.

    Args:
        patients: (N,) whom each case is of: patients are drawn, with all their cases.
    """
    names, of_case = np.unique(list(patients), return_inverse=True)
    count = len(names)
    return generator.multinomial(count, np.full(count, 1 / count), size=draws)[:, of_case]


def pair_interval(pairs: np.ndarray, resamplings: np.ndarray) -> Interval:
    """The mean over ordered pairs of different cases, and its interval over cases.

    Args:
        pairs: (N, N): from case (row) to case (column); not finite where there is no value, as on
            the diagonal.
        resamplings: (draws, N) counts of the cases. All pairs of a drawn case come and go together:
            pairs share their cases and are not independent.

    >>> pairs = np.array([[np.nan, 1.0], [3.0, np.nan]])
    >>> pair_interval(pairs, np.array([[1, 1]])).mean
    2.0
    """
    known = np.isfinite(pairs)
    np.fill_diagonal(known, False)
    if not known.any():
        return Interval(np.nan, np.nan, np.nan)
    values = np.where(known, pairs, 0.0)
    weights = resamplings.astype(float)
    totals = ((weights @ values) * weights).sum(axis=1)
    counts = ((weights @ known) * weights).sum(axis=1)
    means = totals[counts > 0] / counts[counts > 0]
    low, high = np.percentile(means, [2.5, 97.5])
    return Interval(float(values.sum() / known.sum()), float(low), float(high))


def means_over_pairs(
    pairs: Mapping[str, pd.DataFrame],
    columns: Mapping[str, str],
    baseline: str,
    draws: int,
    generator: np.random.Generator,
    patients: Mapping[str, str] | None = None,
) -> pd.DataFrame:
    """A row per method: means of columns over all ordered pairs, with 95 % intervals over cases.

    patients case → patient, where one has several cases: they are drawn together.

    Args:
        pairs: Method → table of from_case_id, case_id and the columns, all of the same cases.
        columns: Name ending in its unit → name of its difference to the baseline's, pair by pair;
            empty where none is wanted.

    Returns:
        Method, cases, and for each name, as border_mm: border_mm, border_low_mm and border_high_mm.
        The same resamplings of the cases serve all methods.
    """
    cases = sorted({*pairs[baseline]["case_id"], *pairs[baseline]["from_case_id"]})
    whose = [patients[case_id] for case_id in cases] if patients else cases
    resamplings = resampled_cases(whose, draws, generator)
    rows = []
    for method, table in pairs.items():
        row: dict[str, object] = {"method": method, "cases": len(cases)}
        for column, difference in columns.items():
            own = as_matrix(table, column, cases)
            wanted = {column: own}
            if difference:
                wanted[difference] = own - as_matrix(pairs[baseline], column, cases)
            for name, matrix in wanted.items():
                what, unit = name.rsplit("_", 1)
                interval = pair_interval(matrix, resamplings)
                row[name] = interval.mean
                row[f"{what}_low_{unit}"] = interval.low
                row[f"{what}_high_{unit}"] = interval.high
        rows.append(row)
    return pd.DataFrame(rows)


def as_matrix(pairs: pd.DataFrame, column: str, cases: Sequence[str]) -> np.ndarray:
    """(N, N), from case (row) to case (column); NaN where the table has no such pair."""
    table = pairs.pivot(index="from_case_id", columns="case_id", values=column)
    result: np.ndarray = table.reindex(index=list(cases), columns=list(cases)).to_numpy(dtype=float)
    return result

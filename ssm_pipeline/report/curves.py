"""The model-quality tables as curves over the number of modes, with standard errors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

DISTANCES = {
    "surface_mm": "surface distance, mean (mm)",
    "hd95_mm": "surface distance, 95th percentile (mm)",
    "chamfer_mm": "Chamfer distance (mm)",
    "correspondence_mm": "distance of corresponding points (mm)",
}
DEFAULT_METHOD = "ours"


def curve(table: pd.DataFrame, value: str) -> pd.DataFrame:
    """One row per method and number of modes: method, modes, value, se (same unit; NaN unknown).

    A table with a row per case is averaged over cases, its standard error being that of the mean;
    a table that is averaged already keeps its own `…_se_…` column.
    """
    table = table.copy()
    if "method" not in table:
        table["method"] = DEFAULT_METHOD
    keys = ["method", "modes"]
    if "case_id" in table:
        grouped = table.groupby(keys, sort=False)[value].agg(["mean", "sem"]).reset_index()
        return grouped.rename(columns={"mean": "value", "sem": "se"})
    stem, _, unit = value.rpartition("_")
    error = table.get(f"{stem}_se_{unit}", pd.Series(np.nan, index=table.index))
    return table[keys].assign(value=table[value], se=error)


def distances_in(metrics: Mapping[str, pd.DataFrame]) -> list[str]:
    """The distance columns that the generalisation and specificity tables hold."""
    tables = [metrics[name] for name in ("generalisation", "specificity") if name in metrics]
    return [column for column in DISTANCES if any(column in table for table in tables)]


def quality_curves(
    metrics: Mapping[str, pd.DataFrame], distance: str = "chamfer_mm"
) -> dict[str, pd.DataFrame]:
    """Curves by name (compactness in percent), of the tables that are there."""
    curves = {}
    if "compactness" in metrics:
        found = curve(metrics["compactness"], "share")
        curves["compactness"] = found.assign(value=100 * found["value"], se=np.nan)
    for name in ("generalisation", "specificity"):
        if name in metrics and distance in metrics[name]:
            curves[name] = curve(metrics[name], distance)
    return curves

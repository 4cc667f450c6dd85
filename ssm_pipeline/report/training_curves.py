"""The training: its losses, and the state of the map during training."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from ssm_pipeline.matching.settings import COLLAPSED_EXTENT

POINTS = 120  # of a curve on the page; each is the mean over as many steps as fall to it
COLLAPSED_COSINE = 0.9  # above it, the features hardly differ

# Column of the losses' table, title, unit.
_WATCHED = (
    ("map_extent", "Extent of the soft map", "share of the target's extent"),
    ("map_sharpness", "Sharpness of the soft map", "largest weight of a row, mean"),
    ("mean_cosine", "Similarity of the features", "mean cosine between vertices"),
    ("share_hit", "Vertices hit", "share of the target's vertices"),
)
_NOT_LOSSES = {"step", "schedule", "seconds", *(column for column, *_ in _WATCHED)}


def training_charts(losses: pd.DataFrame | None) -> list[dict[str, Any]]:
    """Charts for the viewer: title, unit, whether the axis is logarithmic, and lines (name, x, y).

    Args:
        losses: A row per step: step, total, one column per term (NaN before a term begins), and
            those of the watched map that were written. None: no chart.
    """
    if losses is None or losses.empty:
        return []
    numbers = losses.select_dtypes("number")
    terms = [str(name) for name in numbers if name not in _NOT_LOSSES]
    terms = [name for name in terms if (numbers[name].fillna(0) != 0).any()]
    lines = [_line(losses, name) for name in sorted(terms, key=lambda name: name != "total")]
    charts = [
        {
            "title": "Losses",
            "unit": "weighted, mean over steps",
            "log": all(value > 0 for line in lines for value in line["y"]),
            "lines": lines,
        }
    ]
    for column, title, unit in _WATCHED:
        if column in numbers and numbers[column].notna().any():
            line = _line(losses, column)
            charts.append({"title": title, "unit": unit, "log": False, "lines": [line]})
    return [chart for chart in charts if chart["lines"]]


def collapse_warning(losses: pd.DataFrame | None) -> str | None:
    """The warning for a soft map that collapsed, judged by the last tenth of the steps."""
    if losses is None or losses.empty:
        return None
    last = losses.tail(max(len(losses) // 10, 1))
    extent, cosine = (
        float(last[name].mean()) if name in last else float("nan")
        for name in ("map_extent", "mean_cosine")
    )
    found = []
    if extent < COLLAPSED_EXTENT:
        found.append(f"the soft map covers {100 * extent:.0f} % of its target's extent")
    if cosine > COLLAPSED_COSINE:
        found.append(f"all features are nearly parallel (mean cosine {cosine:.2f})")
    if not found:
        return None
    return (
        f"The map has collapsed: {' and '.join(found)}. The matches of the network cannot be "
        "trusted. Train for more steps, or compare with the rows that use no network."
    )


def _line(losses: pd.DataFrame, column: str) -> dict[str, Any]:
    """Means over neighbouring steps, the same ones for every column; none before a term begins."""
    steps = losses["step"] if "step" in losses else pd.Series(np.arange(1, len(losses) + 1))
    x, y = [], []
    for part in np.array_split(np.arange(len(losses)), min(POINTS, len(losses))):
        mean = losses[column].iloc[part].mean()
        if np.isfinite(mean):
            x.append(int(steps.iloc[part[-1]]))
            y.append(float(f"{mean:.5g}"))
    return {"name": column.replace("_", " "), "x": x, "y": y}

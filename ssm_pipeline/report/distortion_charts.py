"""Conformal distortion along each interpolation on the page, as the evaluation measured it."""

from __future__ import annotations

from typing import Any

from ssm_pipeline.report.content import ReportContent

_LINES = {
    "conformal_distortion": "interpolated",
    "straight_conformal_distortion": "straight line",
}


def distortion_charts(content: ReportContent) -> list[dict[str, Any] | None]:
    """One chart a path of `content.paths` (None where it was not measured): its lines over time.

    From the table `interpolation`: case_id, t, and the mean over the triangles of
    `evaluation.matching_quality.conformal_distortion`, for the path and for the straight line
    between the same corresponding points. Empty without that table.
    """
    table = content.metrics.get("interpolation")
    if table is None or not {"case_id", "t"} <= set(table.columns):
        return []
    charts: list[dict[str, Any] | None] = []
    for path in content.paths:
        rows = table[table["case_id"] == path.case_id].sort_values("t")
        lines = [
            {"name": name, "x": rows["t"].tolist(), "y": rows[column].tolist()}
            for column, name in _LINES.items()
            if column in rows
        ]
        charts.append({"lines": lines} if len(rows) and lines else None)
    return charts

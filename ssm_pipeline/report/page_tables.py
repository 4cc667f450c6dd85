"""The tables of the report page: which there are, in which order, under which title."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import pandas as pd

from ssm_pipeline.report.content import ReportContent
from ssm_pipeline.report.curves import distances_in, quality_curves
from ssm_pipeline.report.headings import heading
from ssm_pipeline.report.method_table import without_shown
from ssm_pipeline.report.tables import Cell, ReadableTable, readable
from ssm_pipeline.shape_model.model import ShapeModel

_TITLES = {
    "comparison": "Other columns of the comparison",
    "fit": "Fit of each method's correspondences, mean over the cases",
    "paper": "Published numbers, on other data",
    "recovered_modes": "Recovery of the known modes of variation",
    "unseen_generalisation": "Generalisation to cases unseen in training",
    "unseen_labels_mean": "Labels transferred to cases unseen in training",
    "unseen_specificity": "Specificity relative to cases unseen in training",
    "surface_fits": "Fit of the model to each left-out case",
    "nearest_case": "Nearest other case of each case",
    "truth": "Distance from the known truth",
    "truth_mean": "Distance from the known truth, mean over the cases",
    "labels": "Anatomical labels transferred from all other cases, by case",
    "labels_mean": "Anatomical labels transferred between cases",
    "landmarks": "Landmarks transferred from all other cases, by case",
    "landmarks_mean": "Landmarks transferred between cases",
    "interpolation": "Conformal distortion along the interpolations",
}
# Shown elsewhere on the page, or the rows per case of a table of means.
_PLACED = {
    "comparison_95",
    "compactness",
    "generalisation",
    "generalisation_mean",
    "interpolation_curve",
    "specificity",
}


@dataclass(frozen=True)
class PageTables:
    """The tables of the page; None if the run made none. `others` holds (title, table)."""

    cohort: ReadableTable
    correspondence: ReadableTable
    scores: ReadableTable
    stages: ReadableTable | None
    generalisation: ReadableTable | None
    specificity: ReadableTable | None
    others: tuple[tuple[str, ReadableTable], ...]


def page_tables(content: ReportContent, modes: int) -> PageTables:
    """Return every table of the page; `modes` is how many modes the page shows."""
    names = content.names
    by_modes = {
        name: readable(_by_modes(content, name)) if name in content.metrics else None
        for name in ("generalisation", "specificity")
    }
    others = dict(content.metrics)
    if "comparison" in others:
        others["comparison"] = without_shown(others["comparison"])
    fits = content.correspondence.sort_values("surface_mm", ascending=False)
    return PageTables(
        cohort=readable(_cohort(content.cohort), names),
        correspondence=readable(fits, names),
        scores=readable(_scores(content.model, modes), names, keep=_mode_names(modes)),
        stages=_stages(content),
        others=tuple(
            (_TITLES.get(name, heading(name)), readable(table, names))
            for name, table in others.items()
            if name not in _PLACED and not table.empty
        ),
        **by_modes,
    )


def _mode_names(modes: int) -> tuple[str, ...]:
    return ("case_id", *(f"mode_{mode + 1}_sd" for mode in range(modes)))


def _scores(model: ShapeModel, modes: int) -> pd.DataFrame:
    """One row per case, one column per mode shown, in standard deviations."""
    columns = zip(_mode_names(modes)[1:], model.scores.T, strict=False)
    return pd.DataFrame({"case_id": model.case_ids, **dict(columns)})


def _cohort(cohort: pd.DataFrame) -> pd.DataFrame:
    """Cases left out first, and the words before the numbers."""
    if "dropped" in cohort:
        cohort = cohort.fillna({"dropped": ""}).sort_values(
            "dropped", key=lambda reason: reason == "", kind="stable"
        )
    words = [name for name in ("case_id", "dropped", "warnings") if name in cohort]
    return cohort[[*words, *(name for name in cohort if name not in words)]]


def _stages(content: ReportContent) -> ReadableTable | None:
    if not content.stages:
        return None
    stages = pd.DataFrame([dict(stage) for stage in content.stages])
    plain = [c for c in stages if not stages[c].map(lambda v: isinstance(v, list | dict)).any()]
    if "seconds" in stages:
        stages["seconds"] = stages["seconds"].astype(float)
    table = readable(stages[plain], keep=tuple(plain))
    rows = [
        tuple(
            Cell("reused", "reused", ("",)) if name == "seconds" and cell.text == "–" else cell
            for name, cell in zip(plain, row, strict=True)
        )
        for row in table.rows
    ]
    return dataclasses.replace(table, rows=tuple(rows))


def _by_modes(content: ReportContent, name: str) -> pd.DataFrame:
    """A row per method and number of modes, every distance with its standard error."""
    merged: pd.DataFrame | None = None
    for distance in distances_in(content.metrics):
        table = quality_curves(content.metrics, distance).get(name)
        if table is None:
            continue
        stem, _, unit = distance.rpartition("_")
        table = table.rename(columns={"value": distance, "se": f"{stem}_se_{unit}"})
        merged = table if merged is None else merged.merge(table, on=["method", "modes"])
    return pd.DataFrame() if merged is None else merged.dropna(axis=1, how="all")

"""The page of a comparison: where the shape differs with a covariate, and how surely."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.geometry.surface import vertex_normals
from ssm_pipeline.report.case_names import short_names
from ssm_pipeline.report.headings import heading
from ssm_pipeline.report.packing import Block
from ssm_pipeline.report.payload import plain
from ssm_pipeline.report.rounding import FINE, round_up
from ssm_pipeline.report.settings import ReportSettings
from ssm_pipeline.report.tables import ReadableTable, readable
from ssm_pipeline.report.template import fill
from ssm_pipeline.shape_model.model import ShapeModel


@dataclass(frozen=True, eq=False)
class Effect:
    """How the mean shape changes with one covariate, the others held.

    name             for people: "sex: female against male", "age, 10 years more".
    displacement_mm  (V, 3): of each vertex of the mean.
    p, q             (V,): permutation p-value of each vertex, and the same after the correction
                     for the false discovery rate.
    """

    name: str
    displacement_mm: np.ndarray
    p: np.ndarray
    q: np.ndarray


@dataclass(frozen=True, eq=False)
class Comparison:
    """What `write_compare_page` shows.

    formula     as given, "~ sex + age".
    effects     one a term of the formula.
    covariates  a row a case of the comparison: case_id, and a column a covariate.
    scores      (N, M) standard deviations, in the order of `covariates`.
    tables      title → table: the tests of whole shapes, by mode, power …; shown as they are.
    remarks     what else a reader should know: cases without covariates, refused terms.

    Raises ValueError where the parts don't belong together.
    """

    formula: str
    effects: tuple[Effect, ...]
    covariates: pd.DataFrame
    scores: np.ndarray
    tables: dict[str, pd.DataFrame]
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.effects:
            raise ValueError("a comparison without an effect has nothing to show")
        if len(self.scores) != len(self.covariates) or "case_id" not in self.covariates:
            raise ValueError(
                f"{len(self.scores)} rows of scores and {len(self.covariates)} of covariates "
                f"({', '.join(map(str, self.covariates))}); a row a case, with case_id, is needed"
            )


def write_compare_page(
    comparison: Comparison,
    model: ShapeModel,
    path: Path,
    study: str,
    is_synthetic: bool = False,
    settings: ReportSettings | None = None,
) -> None:
    """Write the page of a comparison to `path` (.html), whole or not at all."""
    text = compare_html(comparison, model, study, is_synthetic, settings or ReportSettings())
    storage.write_text(path, text)


def compare_html(
    comparison: Comparison,
    model: ShapeModel,
    study: str,
    is_synthetic: bool,
    settings: ReportSettings,
) -> str:
    """The page's text. Everything is inside: it opens from a folder without a server."""
    block = Block()
    names = short_names([str(case_id) for case_id in comparison.covariates["case_id"]])
    normals = vertex_normals(model.mean, model.faces)
    along = [np.einsum("vd,vd->v", e.displacement_mm, normals) for e in comparison.effects]
    modes = min(settings.modes, comparison.scores.shape[1])
    description = {
        "study": study,
        "points": block.add_numbers(model.mean),
        "faces": block.add_indices(model.faces),
        "effects": [
            {
                "name": effect.name,
                "displacement": block.add_numbers(effect.displacement_mm),
                "along": block.add_numbers(values),
                "p": block.add_numbers(effect.p),
                "q": block.add_numbers(effect.q),
                "rangeMm": _range_mm(values),
                "sharePercent": 100 * float((effect.q < 0.05).mean()),
                "largestMm": float(np.linalg.norm(effect.displacement_mm, axis=1).max()),
            }
            for effect, values in zip(comparison.effects, along, strict=True)
        ],
        "cases": [names[str(case_id)] for case_id in comparison.covariates["case_id"]],
        "covariates": _covariates(comparison.covariates),
        "scores": np.round(comparison.scores[:, :modes].T, 3).tolist(),
        "share": (model.variances / model.variances.sum())[:modes].tolist(),
    }
    return fill(
        "compare.html",
        plain(description),
        {"block-compare": block.base64()},
        tabs=[("compare", "Effects"), ("scores", "Scores"), ("tests", "Tests")],
        study=study,
        is_synthetic=is_synthetic,
        comparison=comparison,
        cases=len(comparison.covariates),
        tables=_tables(comparison, names),
    )


def _covariates(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Each covariate with its values: numbers as they are, words with their groups."""
    found: list[dict[str, Any]] = []
    for name in table.columns.drop("case_id"):
        column = table[name]
        is_number = pd.api.types.is_numeric_dtype(column) and column.nunique() > 2
        found.append(
            {
                "name": heading(str(name)),
                "values": column.tolist() if is_number else column.astype(str).tolist(),
                "groups": None if is_number else sorted(column.astype(str).unique()),
            }
        )
    return found


def _tables(comparison: Comparison, names: dict[str, str]) -> list[tuple[str, ReadableTable]]:
    return [
        (title, readable(table, names, keep=tuple(table.columns)))
        for title, table in comparison.tables.items()
        if not table.empty
    ]


def _range_mm(values: np.ndarray) -> float:
    """A round colour range in mm that 99 % of the vertices stay within."""
    return round_up(max(float(np.percentile(np.abs(values), 99)), 1e-3), FINE)

"""The page of a comparison: where the shape differs with a covariate, and how surely."""

from __future__ import annotations

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
from ssm_pipeline.report.tables import readable
from ssm_pipeline.report.template import fill
from ssm_pipeline.shape_model.model import ShapeModel
from ssm_pipeline.statistics.compare import ShapeComparison, VertexMap

LEVEL = 0.05  # of q, for the share of the surface that is told


def write_compare_page(
    comparison: ShapeComparison,
    model: ShapeModel,
    path: Path,
    study: str,
    is_synthetic: bool = False,
    settings: ReportSettings | None = None,
) -> None:
    """Write the page of a comparison to `path` (.html), whole or not at all.

    model  with the scores of the cases of `comparison.design`, in its order.
    """
    text = compare_html(comparison, model, study, is_synthetic, settings or ReportSettings())
    storage.write_text(path, text)


def compare_html(
    comparison: ShapeComparison,
    model: ShapeModel,
    study: str,
    is_synthetic: bool,
    settings: ReportSettings,
) -> str:
    """The page's text. Everything is inside: it opens from a folder without a server."""
    covariates = comparison.design.covariates
    if len(model.scores) != len(covariates):
        raise ValueError(
            f"the model has scores of {len(model.scores)} cases and the comparison covariates of "
            f"{len(covariates)}; the same cases are needed"
        )
    block = Block()
    names = short_names([str(case_id) for case_id in covariates["case_id"]])
    modes = min(settings.modes, model.mode_count)
    description = {
        "study": study,
        "points": block.add_numbers(model.mean),
        "faces": block.add_indices(model.faces),
        "effects": [_effect(effect, model, block) for effect in comparison.maps],
        "cases": [names[str(case_id)] for case_id in covariates["case_id"]],
        "covariates": _covariates(covariates),
        "scores": np.round(model.scores[:, :modes].T, 3).tolist(),
        "share": (model.variances / model.variances.sum())[:modes].tolist(),
    }
    return fill(
        "compare.html",
        plain(description),
        {"block-compare": block.base64()},
        tabs=[("compare", "Effects"), ("scores", "Scores"), ("tests", "Tests")],
        study=study,
        is_synthetic=is_synthetic,
        formula=comparison.design.formula,
        effects=[effect.name for effect in comparison.maps],
        cases=len(covariates),
        tests=readable(comparison.tests, names, keep=tuple(comparison.tests)),
        tables=[
            (title, readable(table, keep=tuple(table.columns)))
            for title, table in (
                ("Mode by mode, each effect in standard deviations", comparison.modes),
                ("Power: what this number of cases can show", comparison.power),
            )
        ],
    )


def _effect(effect: VertexMap, model: ShapeModel, block: Block) -> dict[str, Any]:
    along = np.einsum("vd,vd->v", effect.displacement_mm, vertex_normals(model.mean, model.faces))
    return {
        "name": effect.name,
        "displacement": block.add_numbers(effect.displacement_mm),
        "along": block.add_numbers(along),
        "p": block.add_numbers(effect.p),
        "q": block.add_numbers(effect.q),
        "rangeMm": _range_mm(along),
        "sharePercent": 100 * float((effect.q < LEVEL).mean()),
        "largestMm": float(np.linalg.norm(effect.displacement_mm, axis=1).max()),
    }


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


def _range_mm(values: np.ndarray) -> float:
    """A round colour range in mm that 99 % of the vertices stay within."""
    return round_up(max(float(np.percentile(np.abs(values), 99)), 1e-3), FINE)

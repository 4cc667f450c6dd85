"""Shape compared with covariates, as pages show it: what the viewer reads, and tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from ssm_pipeline.geometry.surface import vertex_normals
from ssm_pipeline.report.headings import heading
from ssm_pipeline.report.packing import Block
from ssm_pipeline.report.rounding import FINE, round_up
from ssm_pipeline.report.settings import ReportSettings
from ssm_pipeline.report.tables import ReadableTable, readable
from ssm_pipeline.shape_model.model import ShapeModel
from ssm_pipeline.statistics.compare import ShapeComparison, VertexMap

LEVEL = 0.05  # of q, for the share of the surface that is reported


@dataclass(frozen=True)
class ComparisonTables:
    """The parts of a comparison that do not need the viewer; tables: title → content."""

    formula: str
    cases: int
    tables: Mapping[str, ReadableTable]


def comparison_tables(
    comparisons: Sequence[ShapeComparison], names: Mapping[str, str]
) -> list[ComparisonTables]:
    titles = {
        "tests": "Tests of the whole shape, one row per term of the formula",
        "modes": "Effects per mode, in standard deviations",
        "power": "Power: effects that this number of cases can detect",
    }
    return [
        ComparisonTables(
            one.design.formula,
            len(one.design.covariates),
            {
                title: readable(getattr(one, name), names, keep=tuple(getattr(one, name)))
                for name, title in titles.items()
            },
        )
        for one in comparisons
    ]


def comparison_description(
    comparisons: Sequence[ShapeComparison],
    model: ShapeModel,
    names: Mapping[str, str],
    settings: ReportSettings,
    block: Block,
) -> dict[str, Any]:
    """What the viewer reads of comparisons on one model; arrays go to `block`.

    Args:
        model: With the scores of the cases of each comparison's design, in its order.
        names: Case id → as shown.
    """
    modes = min(settings.modes, model.mode_count)
    for one in comparisons:
        count = len(one.design.covariates)
        if len(model.scores) != count:
            raise ValueError(
                f"the model has scores of {len(model.scores)} cases and the comparison covariates "
                f"of {count}; the same cases are needed"
            )
    return {
        "points": block.add_numbers(model.mean),
        "faces": block.add_indices(model.faces),
        "cases": [names[str(name)] for name in comparisons[0].design.covariates["case_id"]],
        "scores": np.round(model.scores[:, :modes].T, 3).tolist(),
        "share": (model.variances / model.variances.sum())[:modes].tolist(),
        "comparisons": [
            {
                "formula": one.design.formula,
                "effects": [_effect(effect, model, block) for effect in one.maps],
                "covariates": _covariates(one.design.covariates),
            }
            for one in comparisons
        ],
    }


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

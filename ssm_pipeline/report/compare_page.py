"""The page of one comparison: where the shape differs with a covariate, and how certain that is."""

from __future__ import annotations

from pathlib import Path

from ssm_pipeline import storage
from ssm_pipeline.report.case_names import short_names
from ssm_pipeline.report.comparisons import comparison_description, comparison_tables
from ssm_pipeline.report.packing import Block
from ssm_pipeline.report.payload import plain
from ssm_pipeline.report.settings import ReportSettings
from ssm_pipeline.report.template import fill
from ssm_pipeline.shape_model.model import ShapeModel
from ssm_pipeline.statistics.compare import ShapeComparison


def write_compare_page(
    comparison: ShapeComparison,
    model: ShapeModel,
    path: Path,
    study: str,
    is_synthetic: bool = False,
    settings: ReportSettings | None = None,
) -> None:
    """Write the page of a comparison to `path` (.html), whole or not at all: only the report's tab
    of it, to be shared.

    Args:
        model: With the scores of the cases of `comparison.design`, in its order.
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
    block = Block()
    names = short_names([str(case_id) for case_id in comparison.design.covariates["case_id"]])
    described = comparison_description([comparison], model, names, settings, block)
    return fill(
        "compare.html",
        plain({"study": study, "compare": described}),
        {"block-compare": block.base64()},
        tabs=[("compare", "Compare")],
        study=study,
        is_synthetic=is_synthetic,
        comparisons=comparison_tables([comparison], names),
    )

"""The report page: one HTML file that holds its data, pictures and viewer, and works offline."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.geometry import surface
from ssm_pipeline.report.cohort_check import check_cases
from ssm_pipeline.report.comparisons import comparison_tables
from ssm_pipeline.report.content import ReportContent
from ssm_pipeline.report.method_table import method_tables
from ssm_pipeline.report.page_tables import page_tables
from ssm_pipeline.report.payload import build_payload
from ssm_pipeline.report.pictures import interpolation_scenes, mode_range_mm, mode_scenes
from ssm_pipeline.report.rendering import ABOVE, FRONT, LEFT, Scene, render
from ssm_pipeline.report.settings import ReportSettings
from ssm_pipeline.report.tables import flattened
from ssm_pipeline.report.template import fill, webp_address
from ssm_pipeline.report.training_curves import collapse_warning


def write_page(content: ReportContent, path: Path, settings: ReportSettings | None = None) -> None:
    """Write the report page to `path` (.html), whole or not at all."""
    storage.write_text(path, page_html(content, settings or ReportSettings()))


def page_html(content: ReportContent, settings: ReportSettings) -> str:
    """The page's text. Everything is inside: it opens from a folder without a server."""
    payload = build_payload(content, settings)
    metrics = content.metrics
    at_95 = {**metrics, "comparison": metrics.get("comparison_95", pd.DataFrame())}
    return fill(
        "page.html",
        payload.description,
        payload.blocks,
        tabs=_tabs(payload.description),
        study=content.study,
        is_synthetic=content.is_synthetic,
        seed=content.seed,
        facts=_facts(content),
        pictures=_pictures(content, settings),
        tables=page_tables(content, min(settings.modes, content.model.mode_count)),
        modes_shown=_modes_shown(content, settings),
        methods=method_tables(metrics, content.has_network),
        methods_95=method_tables(at_95, content.has_network),
        check=check_cases(content),
        copies=[] if content.copies is None else list(content.copies["exclude"]),
        patients_advice=content.patients_advice,
        comparisons=comparison_tables(content.comparisons, content.names),
        warning=collapse_warning(content.training),
        chamfer_floor=_chamfer_floor(content),
        settings=list(flattened(content.settings)),
        versions=list(flattened(content.versions)),
        has_paths=bool(content.paths) and settings.paths > 0,
        has_training=bool(payload.description["training"]),
        has_distortion=bool(payload.description["distortion"]),
        has_landmarks=content.landmarks is not None,
    )


def _tabs(description: Mapping[str, Any]) -> list[tuple[str, str]]:
    names = [
        "Overview",
        "Modes",
        "Interpolation",
        "Correspondence",
        "Quality",
        "Training",
        "Cohort",
        "Compare",
    ]
    absent = {name for name in ("training", "compare") if not description.get(name)}
    return [(name.lower(), name) for name in names if name.lower() not in absent]


def _facts(content: ReportContent) -> list[tuple[str, str, str]]:
    """Label, value, and what is shown on hover, of the few numbers that sum the study up."""
    model = content.model
    dropped = int((content.cohort.get("dropped", pd.Series(dtype=str)).fillna("") != "").sum())
    volume_ml = surface.volume(model.mean, model.faces) / 1e3
    template = content.aligned.template_id
    return [
        ("Cases in the model", str(len(model.case_ids)), ""),
        ("Cases excluded", str(dropped), ""),
        ("Modes of variation", str(model.mode_count), ""),
        (
            "Modes for 90 / 95 / 99 % of the variance",
            " / ".join(str(model.modes_for(share)) for share in (0.9, 0.95, 0.99)),
            "",
        ),
        (
            "Volume of the mean shape",
            f"{volume_ml:.4g} ml",
            "On the model's triangles, which enclose slightly less than the meshes of the cases.",
        ),
        ("Vertices per shape", str(len(model.mean)), ""),
        ("Template", content.names[template], template),
    ]


def _modes_shown(content: ReportContent, settings: ReportSettings) -> str:
    """Which of the modes the page shows, if not all."""
    model = content.model
    if model.mode_count <= settings.modes:
        return ""
    share = 100 * model.variances[: settings.modes].sum() / model.variances.sum()
    return (
        f"{settings.modes} of {model.mode_count} modes are shown; they explain {share:.1f} % of "
        "the variance. The setting report.modes shows more."
    )


def _pictures(content: ReportContent, settings: ReportSettings) -> dict[str, Any]:
    """The static pictures as data addresses, with what their captions need."""
    model, figures, size = content.model, settings.figures, settings.tile_px
    count = min(figures.modes, model.mode_count)
    range_mm = mode_range_mm(model, count, figures.deviations)
    modes = [
        webp_address(image)
        for image in render(
            mode_scenes(model, count, figures.deviations), size, value_range=range_mm
        )
    ]
    mean = Scene(model.mean, model.faces)
    share = 100 * model.variances / model.variances.sum()
    pictures: dict[str, Any] = {
        "mean": [
            (label, webp_address(render([mean], size, view)[0]))
            for label, view in (("front", FRONT), ("patient's left", LEFT), ("above", ABOVE))
        ],
        "modes": [
            {"share": f"{share[m]:.1f}", "minus": modes[1 + 2 * m], "plus": modes[2 + 2 * m]}
            for m in range(count)
        ],
        "mode_mean": modes[0],
        "deviations": f"{figures.deviations:g}",
        "range_mm": f"{range_mm:g}",
        "strip": [],
    }
    if content.paths:
        path = content.paths[0]
        times = np.linspace(0, 1, figures.interpolation_steps)
        images = render(interpolation_scenes(path, times, times), size)
        pictures["strip"] = [
            (f"{time:.2g}", webp_address(image)) for time, image in zip(times, images, strict=True)
        ]
        pictures["strip_from"] = content.names[path.template_id]
        pictures["strip_to"] = content.names[path.case_id]
    return pictures


def _chamfer_floor(content: ReportContent) -> str | None:
    """The Chamfer distance of a shape to itself, which depends only on the sampling."""
    table = content.metrics.get("generalisation")
    if table is None or not {"chamfer_floor_mm", "points"} <= set(table.columns):
        return None
    return f"{table['chamfer_floor_mm'].mean():.2f} mm with {table['points'].iloc[0]:.0f} points"

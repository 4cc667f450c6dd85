"""The report page: one HTML file that holds its data, pictures and viewer, and works offline."""

from __future__ import annotations

import base64
import io
import json
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pandas as pd
from PIL import Image

from ssm_pipeline import storage
from ssm_pipeline.geometry import surface
from ssm_pipeline.report.content import ReportContent
from ssm_pipeline.report.curves import distances_in, quality_curves
from ssm_pipeline.report.payload import build_payload
from ssm_pipeline.report.pictures import interpolation_scenes, mode_range_mm, mode_scenes
from ssm_pipeline.report.rendering import ABOVE, FRONT, LEFT, Scene, render
from ssm_pipeline.report.settings import ReportSettings
from ssm_pipeline.report.tables import ReadableTable, flattened, heading, readable

VIEWER = Path(__file__).parent / "viewer"


def write_page(content: ReportContent, path: Path, settings: ReportSettings | None = None) -> None:
    """Write the report page to `path` (.html), whole or not at all."""
    storage.write_text(path, page_html(content, settings or ReportSettings()))


def page_html(content: ReportContent, settings: ReportSettings) -> str:
    """The page's text. Everything is inside: it opens from a folder without a server."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(VIEWER),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    payload = build_payload(content, settings)
    # A "<" inside a script element could end it: case ids are the user's own text.
    description = json.dumps(payload.description, allow_nan=False).replace("<", "\\u003c")
    return environment.get_template("page.html").render(
        study=content.study,
        is_synthetic=content.is_synthetic,
        seed=content.seed,
        facts=_facts(content),
        pictures=_pictures(content, settings),
        tables=_tables(content),
        other_tables=_other_tables(content),
        chamfer_floor=_chamfer_floor(content),
        settings=list(flattened(content.settings)),
        versions=list(flattened(content.versions)),
        has_paths=bool(content.paths) and settings.paths > 0,
        has_landmarks=content.landmarks is not None,
        style=(VIEWER / "style.css").read_text(encoding="utf-8"),
        script=(VIEWER / "viewer.js").read_text(encoding="utf-8"),
        description=description,
        blocks=payload.blocks,
    )


def _facts(content: ReportContent) -> list[tuple[str, str]]:
    """Label and value of the few numbers that sum the study up."""
    model = content.model
    dropped = int((content.cohort.get("dropped", pd.Series(dtype=str)).fillna("") != "").sum())
    volume_ml = surface.volume(model.mean, model.faces) / 1e3
    return [
        ("Cases in the model", str(len(model.case_ids))),
        ("Cases left out", str(dropped)),
        ("Modes of variation", str(model.mode_count)),
        (
            "Modes for 90 / 95 / 99 % of the variance",
            " / ".join(str(model.modes_for(share)) for share in (0.9, 0.95, 0.99)),
        ),
        ("Volume of the mean shape", f"{volume_ml:.4g} ml"),
        ("Vertices per shape", str(len(model.mean))),
        ("Template", content.names[content.aligned.template_id]),
    ]


def _pictures(content: ReportContent, settings: ReportSettings) -> dict[str, Any]:
    """The static pictures as data addresses, with what their captions need."""
    model, figures, size = content.model, settings.figures, settings.tile_px
    count = min(figures.modes, model.mode_count)
    range_mm = mode_range_mm(model, count, figures.deviations)
    modes = [
        _data_address(image)
        for image in render(
            mode_scenes(model, count, figures.deviations), size, value_range=range_mm
        )
    ]
    mean = Scene(model.mean, model.faces)
    share = 100 * model.variances / model.variances.sum()
    pictures: dict[str, Any] = {
        "mean": [
            (label, _data_address(render([mean], size, view)[0]))
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
            (f"{time:.2g}", _data_address(image)) for time, image in zip(times, images, strict=True)
        ]
        pictures["strip_from"] = content.names[path.template_id]
        pictures["strip_to"] = content.names[path.case_id]
    return pictures


def _data_address(image: np.ndarray) -> str:
    buffer = io.BytesIO()
    # WebP with transparency is about a sixth of PNG; every browser since 2020 shows it.
    Image.fromarray(image).save(buffer, "WEBP", quality=88, method=4)
    return "data:image/webp;base64," + base64.b64encode(buffer.getvalue()).decode()


def _tables(content: ReportContent) -> dict[str, ReadableTable | None]:
    """Every table of the page; None where the run made none."""
    cohort = content.cohort
    if "dropped" in cohort:  # what is missing comes first, not below the fold
        cohort = cohort.fillna({"dropped": ""}).sort_values(
            "dropped", key=lambda reason: reason == "", kind="stable"
        )
    words = [name for name in ("case_id", "dropped", "warnings") if name in cohort]
    cohort = cohort[[*words, *(name for name in cohort if name not in words)]]
    tables: dict[str, ReadableTable | None] = {
        "stages": None,
        "comparison": None,
        "generalisation": None,
        "specificity": None,
        "cohort": readable(cohort),
        "correspondence": readable(
            content.correspondence.sort_values("surface_mm", ascending=False)
        ),
    }
    if content.stages:
        stages = pd.DataFrame([dict(stage) for stage in content.stages])
        plain = [c for c in stages if not stages[c].map(lambda v: isinstance(v, list | dict)).any()]
        tables["stages"] = readable(stages[plain])
    if "comparison" in content.metrics:
        tables["comparison"] = readable(content.metrics["comparison"])
    for name in ("generalisation", "specificity"):
        if name in content.metrics:
            tables[name] = readable(_by_modes(content, name))
    return tables


def _chamfer_floor(content: ReportContent) -> str | None:
    """What the Chamfer distance of a shape to itself is, which its sampling alone decides."""
    table = content.metrics.get("generalisation")
    if table is None or not {"chamfer_floor_mm", "points"} <= set(table.columns):
        return None
    return f"{table['chamfer_floor_mm'].mean():.2f} mm with {table['points'].iloc[0]:.0f} points"


def _other_tables(content: ReportContent) -> list[tuple[str, ReadableTable]]:
    """Tables that the page has no place of its own for, such as errors against a known truth."""
    titles = {
        "comparison_95": "Each method with as many modes as hold 95 % of its own variance",
        "fit": "Fit of each method's correspondences, mean over the cases",
        "paper": "The numbers published, on other data",
        "recovered_modes": "Recovered modes of the known truth",
        "retraining": "Generalisation to cases that the matcher has not seen",
        "truth": "Distance from the known truth",
        "truth_mean": "Distance from the known truth, mean over the cases",
    }
    placed = {"compactness", "generalisation", "generalisation_mean", "specificity", "comparison"}
    return [
        (titles.get(name, heading(name)), readable(table))
        for name, table in content.metrics.items()
        if name not in placed
    ]


def _by_modes(content: ReportContent, name: str) -> pd.DataFrame:
    """A row a method and number of modes, every distance with its standard error."""
    merged: pd.DataFrame | None = None
    for distance in distances_in(content.metrics):
        table = quality_curves(content.metrics, distance).get(name)
        if table is None:
            continue
        stem, _, unit = distance.rpartition("_")
        table = table.rename(columns={"value": distance, "se": f"{stem}_se_{unit}"})
        merged = table if merged is None else merged.merge(table, on=["method", "modes"])
    return pd.DataFrame() if merged is None else merged.dropna(axis=1, how="all")

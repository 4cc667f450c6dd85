"""Static figures for print: modes, interpolation, correspondence, quality curves."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import matplotlib as mpl
import matplotlib.font_manager
import numpy as np
import pandas as pd
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ssm_pipeline import storage
from ssm_pipeline.records import ShapePath
from ssm_pipeline.report.content import ReportContent
from ssm_pipeline.report.curves import DISTANCES, distances_in, quality_curves
from ssm_pipeline.report.grid_pattern import patterned_scenes
from ssm_pipeline.report.pictures import interpolation_scenes, mode_range_mm, mode_scenes
from ssm_pipeline.report.rendering import render
from ssm_pipeline.report.settings import FigureSettings
from ssm_pipeline.shape_model.model import ShapeModel

_MM_PER_INCH = 25.4
_PLAIN = FigureSettings()


def mode_figure(model: ShapeModel, settings: FigureSettings = _PLAIN) -> Figure:
    """The leading modes, a column each: mean − k SD above, mean + k SD below, mean at the left.

    Colour is the displacement along the mean's normal, mm, one scale for all.
    """
    count = min(settings.modes, model.mode_count)
    range_mm = mode_range_mm(model, count, settings.deviations)
    scenes = mode_scenes(model, count, settings.deviations)
    with _fonts(settings):
        figure, axes = _image_grid(2, count + 1, settings)
        images = render(scenes, _pixels(settings, count + 1), value_range=range_mm)
        _show(axes[0, 0], images[0], "mean")
        axes[1, 0].axis("off")
        share = 100 * model.variances / model.variances.sum()
        for mode in range(count):
            minus, plus = images[1 + 2 * mode : 3 + 2 * mode]
            _show(axes[0, mode + 1], minus, f"mode {mode + 1}\n{share[mode]:.0f} %")
            _show(axes[1, mode + 1], plus, "")
        for axis, sign in zip(axes[:, 1], "−+", strict=True):
            _row_label(axis, f"{sign}{settings.deviations:g} SD")
        bar = figure.colorbar(
            ScalarMappable(Normalize(-range_mm, range_mm), "RdBu_r"),
            ax=axes[1, 0],
            location="bottom",
            fraction=0.12,
            aspect=12,
            anchor=(0.5, 1.0),
        )
        bar.set_label("displacement along\nthe normal (mm)")
    return figure


def interpolation_strip(path: ShapePath, settings: FigureSettings = _PLAIN) -> Figure:
    """Template to case in even steps of time, pose alone above, pose and shape below."""
    times = np.linspace(0, 1, settings.interpolation_steps)
    rows = ("pose only", 0.0), ("pose and shape", 1.0)
    scenes = [
        scene
        for _, t_s in rows
        for scene in interpolation_scenes(path, times, np.full(len(times), t_s))
    ]
    with _fonts(settings):
        figure, axes = _image_grid(len(rows), len(times), settings)
        images = render(scenes, _pixels(settings, len(times)))
        for number, (axis, image) in enumerate(zip(axes.flat, images, strict=True)):
            _show(axis, image, f"t = {times[number]:.2g}" if number < len(times) else "")
        for axis, (label, _) in zip(axes[:, 0], rows, strict=True):
            _row_label(axis, label)
    return figure


def correspondence_figure(content: ReportContent, settings: FigureSettings = _PLAIN) -> Figure:
    """The template's grid mapped to the cases that fit worst, with their surface distance."""
    table = content.correspondence.set_index("case_id").sort_values("surface_mm", ascending=False)
    others = set(content.aligned.case_ids) - {content.aligned.template_id}
    shown = [case for case in table.index if case in others]
    shown = shown[: settings.correspondence_cases]
    template = content.template_vertices
    ids = content.aligned.case_ids
    shapes = [template, *(content.aligned.vertices[ids.index(case)] for case in shown)]
    columns = min(len(shapes), 5)
    with _fonts(settings):
        figure, axes = _image_grid(-(-len(shapes) // columns), columns, settings)
        scenes = patterned_scenes(shapes, content.aligned.faces, template)
        images = render(scenes, _pixels(settings, columns))
        titles = [
            "template",
            *(f"{content.names[case]}\n{table.loc[case, 'surface_mm']:.2f} mm" for case in shown),
        ]
        for axis in axes.flat:
            axis.axis("off")
        for axis, image, title in zip(axes.flat, images, titles, strict=False):
            _show(axis, image, title)
    return figure


def curves(
    metrics: Mapping[str, pd.DataFrame],
    settings: FigureSettings = _PLAIN,
    distance: str | None = None,
) -> Figure:
    """Compactness, generalisation, specificity over the number of modes, a line per method.

    Bands are ± one standard error of the mean.

    Args:
        distance: A column of the tables; by default the first of `DISTANCES` that they hold.

    Raises:
        ValueError: If no table is there.
    """
    distance = distance or next(iter(distances_in(metrics)), "surface_mm")
    found = quality_curves(metrics, distance)
    if not found:
        raise ValueError("no table of compactness, generalisation or specificity to draw")
    methods = list(dict.fromkeys(m for table in found.values() for m in table["method"]))
    styles = {method: _line_style(number) for number, method in enumerate(methods)}
    columns = min(4, len(methods))
    with _fonts(settings):
        width = settings.width_mm / _MM_PER_INCH
        below = 0.16 * -(-len(methods) // columns) if len(methods) > 1 else 0.0  # the legend
        figure = Figure(figsize=(width, width / 3 + 0.3 + below), layout="constrained")
        FigureCanvasAgg(figure)
        lines = {}
        for axis, (name, table) in zip(
            figure.subplots(1, len(found), squeeze=False)[0], found.items(), strict=True
        ):
            for method, line in table.groupby("method", sort=False):
                style = styles[str(method)]
                low, high = line["value"] - line["se"], line["value"] + line["se"]
                (lines[method],) = axis.plot(line["modes"], line["value"], linewidth=1.2, **style)
                axis.fill_between(
                    line["modes"], low, high, alpha=0.2, linewidth=0, color=style["color"]
                )
            axis.set(title=name, xlabel="number of modes")
            axis.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
            axis.set_ylabel("variance (%)" if name == "compactness" else DISTANCES[distance])
            axis.spines[["top", "right"]].set_visible(False)
        if len(methods) > 1:
            handles = [lines[method] for method in methods]
            figure.legend(
                handles, methods, loc="outside lower center", ncols=columns, frameon=False
            )
    return figure


def _line_style(number: int) -> dict[str, str]:
    """Once round matplotlib's ten colours, the dashes move on by one: no two lines are alike."""
    dashes = ("-", "--", ":", "-.")
    return {"color": f"C{number % 10}", "linestyle": dashes[number // 10 % len(dashes)]}


def write_figures(
    content: ReportContent, folder: Path, settings: FigureSettings = _PLAIN
) -> tuple[Path, ...]:
    """Write every figure of the report to `folder`; returns the files."""
    figures = {
        "modes": mode_figure(content.model, settings),
        "correspondence": correspondence_figure(content, settings),
    }
    for path in content.paths[:1]:
        figures["interpolation"] = interpolation_strip(path, settings)
    if quality_curves(content.metrics):
        figures["quality"] = curves(content.metrics, settings)
    written = []
    for name, figure in figures.items():
        written.append(folder / f"{name}.{settings.format}")
        with storage.written_whole(written[-1]) as temporary:
            temporary.write_bytes(figure_bytes(figure, settings))
    return tuple(written)


def figure_bytes(figure: Figure, settings: FigureSettings = _PLAIN) -> bytes:
    """The figure as a file's content, in the settings' format and resolution."""
    buffer = io.BytesIO()
    # Without a date, the same figure is the same file.
    metadata = {"CreationDate": None} if settings.format == "pdf" else {}
    with _fonts(settings):
        figure.savefig(buffer, format=settings.format, dpi=settings.dpi, metadata=metadata)
    return buffer.getvalue()


@contextmanager
def _fonts(settings: FigureSettings) -> Iterator[None]:
    fonts = [settings.font, "Liberation Sans", "DejaVu Sans"]
    size = settings.font_size_pt
    with mpl.rc_context(
        {
            "font.family": _installed(fonts),
            "font.size": size,
            "axes.titlesize": size,
            "axes.labelsize": size,
            "xtick.labelsize": size - 1,
            "ytick.labelsize": size - 1,
            "legend.fontsize": size - 1,
            "pdf.fonttype": 42,  # TrueType, editable: journals refuse Type 3
        }
    ):
        yield


def _installed(fonts: Sequence[str]) -> str:
    """The first of the fonts that this machine has; DejaVu Sans comes with matplotlib."""
    known = set(mpl.font_manager.get_font_names())
    return next((font for font in fonts if font in known), "DejaVu Sans")


def _pixels(settings: FigureSettings, columns: int) -> int:
    return round(settings.width_mm / _MM_PER_INCH / columns * settings.dpi)


def _image_grid(rows: int, columns: int, settings: FigureSettings) -> tuple[Figure, np.ndarray]:
    width = settings.width_mm / _MM_PER_INCH
    height = rows * (width / columns + 2.2 * settings.font_size_pt / 72)
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False)


def _row_label(axis: mpl.axes.Axes, label: str) -> None:
    place = axis.transAxes
    axis.text(-0.04, 0.5, label, rotation=90, va="center", ha="right", transform=place)


def _show(axis: mpl.axes.Axes, image: np.ndarray, title: str) -> None:
    axis.imshow(image, interpolation="antialiased")
    axis.set_title(title)
    axis.axis("off")

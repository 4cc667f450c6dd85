from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread
from synthetic_report import even_sphere, make_cohort

from ssm_pipeline.geometry.surface import vertex_normals
from ssm_pipeline.report import figures
from ssm_pipeline.report.pictures import mode_range_mm, signed_distance
from ssm_pipeline.report.rendering import ABOVE, FRONT, LEFT, Scene, render
from ssm_pipeline.report.settings import FigureSettings

SMALL = FigureSettings(width_mm=120, dpi=50, format="png", modes=2, interpolation_steps=3)


def test_normals_of_a_sphere_are_its_directions() -> None:
    points, faces = even_sphere(2000)
    # Second order in the edge length, 0.08 here.
    np.testing.assert_allclose(vertex_normals(10 * points, faces), points, atol=0.02)


def test_views_show_the_right_axes() -> None:
    points, faces = even_sphere(800)
    box = points * (10.0, 20.0, 40.0)  # left-right, front-back, head-foot
    for view, ratio in ((FRONT, 10 / 40), (LEFT, 20 / 40), (ABOVE, 10 / 20)):
        (image,) = render([Scene(box, faces)], 200, view)
        rows, columns = (np.ptp(np.flatnonzero((image[..., 3] > 0).any(axis=a))) for a in (1, 0))
        assert columns / rows == pytest.approx(ratio, abs=0.03)  # a pixel or two in a hundred


def test_left_is_on_the_viewers_right_and_head_is_up() -> None:
    points, faces = even_sphere(800)
    marked = points * 20
    values = np.where((points[:, 0] > 0) & (points[:, 2] > 0), 1.0, -1.0)
    (image,) = render([Scene(marked, faces, values)], 120, FRONT)
    red = image[..., 0].astype(int) - image[..., 2] > 60
    rows, columns = np.nonzero(red & (image[..., 3] > 0))
    assert rows.mean() < image.shape[0] / 2
    assert columns.mean() > image.shape[1] / 2


def test_every_picture_of_a_set_is_its_own_and_all_share_a_scale() -> None:
    points, faces = even_sphere(800)
    large, small = render([Scene(r * points, faces) for r in (20, 10)], 120, FRONT)
    covered = [(image[..., 3] > 0).sum() for image in (large, small)]
    assert covered[0] / covered[1] == pytest.approx(4, rel=0.05)  # pixels at the rim


def test_signed_distance_of_a_grown_sphere_is_the_growth(content: Any) -> None:
    model = content.model
    normals = vertex_normals(model.mean, model.faces)
    np.testing.assert_allclose(signed_distance(model.mean + 2.5 * normals, model), 2.5)
    assert mode_range_mm(model, 1, 2.0) >= mode_range_mm(model, 1, 1.0)


@pytest.mark.parametrize(
    "draw",
    [
        lambda c: figures.mode_figure(c.model, SMALL),
        lambda c: figures.correspondence_figure(c, SMALL),
        lambda c: figures.interpolation_strip(c.paths[0], SMALL),
        lambda c: figures.curves(c.metrics, SMALL),
    ],
    ids=["modes", "correspondence", "interpolation", "curves"],
)
def test_figures_have_the_width_asked_and_show_something(content: Any, draw: Any) -> None:
    image = imread(io.BytesIO(figures.figure_bytes(draw(content), SMALL)))
    assert image.shape[1] == pytest.approx(120 / 25.4 * 50, abs=1)
    assert image[..., :3].std() > 0.02


def test_written_pdf_embeds_editable_fonts_and_repeats(content: Any, tmp_path: Path) -> None:
    settings = SMALL.model_copy(update={"format": "pdf"})
    files = figures.write_figures(content, tmp_path, settings)
    assert {f.name for f in files} == {
        "modes.pdf",
        "correspondence.pdf",
        "interpolation.pdf",
        "quality.pdf",
    }
    quality = (tmp_path / "quality.pdf").read_bytes()
    assert quality.startswith(b"%PDF")
    assert b"/Type3" not in quality
    again = figures.figure_bytes(figures.curves(content.metrics, settings), settings)
    assert again == quality


def test_fourteen_methods_are_told_apart_and_named_once() -> None:
    figure = figures.curves(make_cohort(60, 6).metrics, SMALL)
    for axis in figure.axes:
        assert len({(line.get_color(), line.get_linestyle()) for line in axis.lines}) == 14
        assert axis.get_legend() is None
    assert len(figure.legends[0].get_texts()) == 14
    assert "surface distance" in figure.axes[1].get_ylabel()


def test_long_ids_are_short_under_pictures() -> None:
    figure = figures.correspondence_figure(make_cohort(60, 6), SMALL)
    assert max(len(axis.get_title().split("\n")[0]) for axis in figure.axes) < 12


def test_no_tables_no_curves() -> None:
    with pytest.raises(ValueError, match="no table"):
        figures.curves({})

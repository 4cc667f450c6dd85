"""The page in a real browser, from file://, without a network."""

from __future__ import annotations

import dataclasses
import io
import json
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import trimesh
from matplotlib.image import imread
from synthetic_report import make_cohort, make_content

from ssm_pipeline.evaluation.matching_quality import conformal_distortion
from ssm_pipeline.report.page import page_html, write_page
from ssm_pipeline.report.payload import build_payload
from ssm_pipeline.report.settings import ReportSettings
from ssm_pipeline.report.template import VIEWER

SETTINGS = ReportSettings(modes=5, case_faces=500, tile_px=96)
TABS = ["overview", "modes", "interpolation", "correspondence", "quality", "cohort"]


@pytest.fixture(scope="module")
def file(content: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "index.html"
    write_page(content, path, SETTINGS)
    return path


@pytest.fixture
def page(watched_page: Any, file: Path) -> Any:
    return watched_page(file)


def positions(page: Any, part: str = "modes") -> np.ndarray:
    flat = page.evaluate(f"[...viewer.{part}.positions()]")
    return np.array(flat).reshape(-1, 3)


def test_the_page_opens_with_its_pictures(page: Any) -> None:
    page.wait_for_function("performance.getEntriesByName('first-contentful-paint')[0]?.startTime")
    assert page.locator("p.synthetic").inner_text().startswith("SYNTHETIC PHANTOM COHORT")
    shown = "[...document.images].every((i) => i.complete && i.naturalWidth > 20)"
    assert page.evaluate(shown)


def test_sliders_give_exactly_the_models_instance(page: Any, content: Any) -> None:
    page.click("#tab-modes")
    page.locator("#mode-0").fill("1.5")
    page.locator("#mode-3").fill("-2.25")
    expected = content.model.reconstruct(np.array([1.5, 0, 0, -2.25]))
    np.testing.assert_allclose(positions(page), expected, atol=1e-3)
    solid = trimesh.Trimesh(expected, content.model.faces, process=False)
    shown = page.locator("#modes-readouts dd").all_inner_texts()
    values = [float(text.split("\n")[0]) for text in shown]
    exact = [solid.volume / 1e3, solid.area / 1e2, *solid.extents]
    np.testing.assert_allclose(values, exact, atol=0.051)  # shown with one decimal
    measured = page.evaluate("viewer.modes.measures().volumeMl")
    assert measured == pytest.approx(solid.volume / 1e3, rel=1e-5)  # float32 positions
    page.click("#modes-reset")
    np.testing.assert_allclose(positions(page), content.model.mean, atol=1e-3)


def test_the_picture_follows_the_slider(page: Any) -> None:
    page.click("#tab-modes")
    canvas = page.locator("#modes-stage canvas")
    before = canvas.screenshot()
    page.locator("#mode-0").fill("3")
    page.evaluate("viewer.modes.drawNow()")
    assert canvas.screenshot() != before


def test_a_tick_shows_that_cases_reconstruction(page: Any, content: Any) -> None:
    page.click("#tab-modes")
    assert page.locator(".ticks").count() == SETTINGS.modes
    ticks = page.locator(".ticks").first.locator("button")
    assert ticks.count() == len(content.model.case_ids)
    case = 3
    ticks.nth(case).dispatch_event("click")
    scores = content.model.scores[case, : SETTINGS.modes]
    np.testing.assert_allclose(page.evaluate("viewer.modes.scores()"), scores)
    np.testing.assert_allclose(positions(page), content.model.reconstruct(scores), atol=1e-3)
    note = page.locator("#modes-note").inner_text()
    error = np.linalg.norm(
        content.model.reconstruct(scores) - content.aligned.vertices[case], axis=1
    ).mean()
    assert f"{content.model.case_ids[case]} reconstructed from 5 modes" in note
    assert f"{error:.2f} mm" in note
    assert "Green: the case's own surface" in note


def test_play_moves_one_mode_and_stops(page: Any) -> None:
    page.click("#tab-modes")
    button = page.get_by_label("Play mode 2")
    button.click()
    page.wait_for_function("Math.abs(viewer.modes.scores()[1]) > 0.2")
    button.click()
    stopped = page.evaluate("viewer.modes.scores()")
    page.wait_for_timeout(100)
    assert page.evaluate("viewer.modes.scores()") == stopped
    assert stopped[0] == 0


def test_every_tab_by_keyboard_alone(page: Any) -> None:
    page.keyboard.press("Tab")
    for name in TABS[1:]:
        page.keyboard.press("ArrowRight")
        assert page.locator(f"#panel-{name}").is_visible()
        assert page.locator("[role=tabpanel]:visible").count() == 1
        assert page.evaluate("document.activeElement.id") == f"tab-{name}"
    page.keyboard.press("ArrowRight")
    assert page.locator("#panel-overview").is_visible()
    page.keyboard.press("End")
    assert page.locator("#panel-cohort").is_visible()


def test_interpolation_shows_the_path(page: Any, content: Any) -> None:
    page.click("#tab-interpolation")
    page.select_option("#interpolation-pair", "1")
    page.evaluate("viewer.interpolation.set(0.35, 0.5)")
    expected = content.paths[1].at(0.35, 0.5)
    expected -= expected.mean(axis=0)
    # 16-bit points: extents of 250 mm in steps of 4 µm, twice.
    np.testing.assert_allclose(positions(page, "interpolation"), expected, atol=0.01)
    page.evaluate("viewer.interpolation.set(0, 0)")
    at_rest = np.array(page.evaluate("[...viewer.interpolation.distortion()]"))
    np.testing.assert_allclose(at_rest, 2, atol=1e-3)
    with page.expect_download() as download:
        page.click("#interpolation-picture")
    assert download.value.suggested_filename.endswith(".png")


def test_saved_frames_are_a_whole_archive_of_pictures(page: Any, tmp_path: Path) -> None:
    page.set_viewport_size({"width": 400, "height": 400})  # small pictures are quick
    page.click("#tab-interpolation")
    with page.expect_download() as download:
        page.click("#interpolation-frames")
    download.value.save_as(tmp_path / "frames.zip")
    with zipfile.ZipFile(tmp_path / "frames.zip") as archive:
        assert archive.testzip() is None
        assert archive.namelist() == [f"frame_{n:03d}.png" for n in range(41)]
        first, last = (imread(io.BytesIO(archive.read(f"frame_{n:03d}.png"))) for n in (0, 40))
    assert first.shape == last.shape
    assert np.abs(first - last).max() > 0.1


def test_distortion_is_that_of_the_singular_values(page: Any, content: Any) -> None:
    page.click("#tab-interpolation")
    page.evaluate("viewer.interpolation.set(1, 1)")
    shown = np.array(page.evaluate("[...viewer.interpolation.distortion()]"))
    path = content.paths[0]
    edges = [
        points[path.faces[:, 1:]] - points[path.faces[:, :1]]
        for points in (path.at(0, 1), path.at(1, 1))
    ]
    # In an orthonormal frame of each triangle, the map's singular values s1 ≥ s2.
    flat = [np.linalg.qr(e.transpose(0, 2, 1))[1] for e in edges]
    s1, s2 = np.linalg.svd(flat[1] @ np.linalg.inv(flat[0]), compute_uv=False).T
    np.testing.assert_allclose(shown, s1 / s2 + s2 / s1, rtol=5e-3)
    evaluated = conformal_distortion(path.at(0, 1), path.at(1, 1), path.faces)
    np.testing.assert_allclose(shown, evaluated, rtol=5e-3)


def test_the_readouts_are_the_means_that_the_evaluation_gives(page: Any, content: Any) -> None:
    page.click("#tab-interpolation")
    page.locator("#interpolation-t").fill("0.6")
    assert page.locator("#interpolation-ts").input_value() == "0.6"  # pose and shape together
    path = content.paths[0]
    start, end = path.at(0, 0), path.at(1, 1)
    shapes = path.at(0.6, 0.6), 0.4 * start + 0.6 * end
    expected = [conformal_distortion(start, shape, path.faces).mean() for shape in shapes]
    readouts = page.locator("#interpolation-readouts dd").all_inner_texts()
    assert [float(readouts[0]), float(readouts[2])] == pytest.approx(expected, abs=2e-3)


def test_worst_fit_comes_first_after_the_template(page: Any, content: Any) -> None:
    page.click("#tab-correspondence")
    shown = page.evaluate("viewer.correspondence.order()")
    table = content.correspondence.sort_values("surface_mm", ascending=False)
    template = content.aligned.template_id
    rest = [case for case in table["case_id"] if case != template]
    assert shown == [f"{template} (template)", *rest]
    cell = page.locator(".cell canvas").nth(1)
    drawn = """(canvas) => {
        const d = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
        let opaque = 0, red = 0;
        for (let i = 0; i < d.length; i += 4) {
            if (d[i + 3] > 200) opaque++;
            if (d[i] > 180 && d[i + 1] < 60 && d[i + 2] < 60) red++;
        }
        return [opaque / (d.length / 4), red];
    }"""
    page.wait_for_function("document.querySelectorAll('.cell canvas')[1].width > 50")
    page.wait_for_timeout(100)
    covered, red = cell.evaluate(drawn)
    assert 0.1 < covered < 0.9
    assert red > 5  # a landmark


def test_charts_read_out_values(page: Any, content: Any) -> None:
    page.click("#tab-quality")
    page.select_option("#quality-distance", "chamfer_mm")
    chart = page.locator("#quality-charts .chart").nth(2)
    chart.locator("svg").first.focus()
    page.keyboard.press("ArrowLeft")
    modes = content.model.mode_count - 1
    expected = content.metrics["specificity"].query("modes == @modes").set_index("method")
    assert chart.locator("caption").inner_text() == f"with {modes} modes"
    rows = chart.locator(".reading tbody tr").all_inner_texts()
    shown = [re.sub(r"\s+", " ", row).strip() for row in rows]
    assert shown == [  # the best first
        f"{method} {expected.loc[method, 'chamfer_mm']:.2f} ± 0.03" for method in ("ours", "s3m")
    ]


def test_ten_methods_are_told_apart(content: Any, browser: Any, tmp_path: Path) -> None:
    table = content.metrics["compactness"].query("method == 'ours'")
    many = pd.concat([table.assign(method=f"method {number}") for number in range(10)])
    path = tmp_path / "index.html"
    write_page(
        dataclasses.replace(content, metrics={**content.metrics, "compactness": many}),
        path,
        SETTINGS,
    )
    page = browser.new_page()
    page.goto(path.as_uri())
    page.click("#tab-quality")
    page.wait_for_selector("#quality-charts .chart")
    lines = page.evaluate(
        "[...document.querySelector('#quality-charts .chart svg')"
        ".querySelectorAll('path.curve')].map(p => ['stroke', 'stroke-dasharray',"
        " 'stroke-dashoffset'].map(name => p.getAttribute(name)).join())"
    )
    assert len(lines) == len(set(lines)) == 10
    # All ten lines coincide here: the page says so and gives each its stripes.
    note = page.locator("#quality-charts .chart").first.locator(".note").inner_text()
    assert "method 0 = method 1 = " in note
    page.locator("#quality-charts .reading button", has_text="method 7").click()
    faint = page.locator("#quality-charts .chart").first.locator(".line.faint")
    assert faint.count() == 9
    page.close()


@pytest.mark.parametrize("width", [390, 1280, 1920])
def test_no_tab_scrolls_sideways(page: Any, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 844})
    for name in TABS:
        page.click(f"#tab-{name}")
        assert page.evaluate("document.documentElement.scrollWidth") <= width


@pytest.fixture(scope="module")
def cohort_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """29 cases with ids of 64 characters, 14 methods, training curves, cohort check."""
    path = tmp_path_factory.mktemp("cohort") / "index.html"
    write_page(make_cohort(150), path, SETTINGS)
    return path


CUT = """[...document.querySelectorAll('.scroll')].filter((box) => box.offsetParent !== null)
    .filter((box) => box.scrollWidth > box.clientWidth).map((box) => box.ariaLabel)"""
TALL = """[...document.querySelectorAll('.scroll thead')].filter((t) => t.offsetParent !== null)
    .filter((t) => t.offsetHeight > 5 * 16).map((t) => t.textContent)"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_tables_of_a_real_cohort_fit_a_laptop(browser: Any, cohort_file: Path, scheme: str) -> None:
    page = browser.new_page(viewport={"width": 1280, "height": 800}, color_scheme=scheme)
    page.goto(cohort_file.as_uri())
    for name in [*TABS, "training"]:
        page.click(f"#tab-{name}")
        page.evaluate("for (const d of document.querySelectorAll('details')) d.open = true")
        assert page.evaluate(CUT) == [], name
        assert page.evaluate(TALL) == [], name
        assert page.evaluate("document.documentElement.scrollWidth") <= 1280
    page.close()


def test_whole_ids_are_on_hover_and_in_the_saved_table(
    browser: Any, cohort_file: Path, tmp_path: Path
) -> None:
    page = browser.new_page()
    page.goto(cohort_file.as_uri())
    page.click("#tab-cohort")
    whole = page.locator("#table-cohort tbody td").first.get_attribute("title")
    assert len(whole) > 50
    assert whole.endswith(page.locator("#table-cohort tbody td").first.inner_text().strip("…"))
    with page.expect_download() as download:
        page.click("button[data-save=table-cohort]")
    download.value.save_as(tmp_path / "cohort.csv")
    table = pd.read_csv(tmp_path / "cohort.csv", dtype=str)
    assert table["Case"].tolist()[0] == whole
    assert len(table) == 30
    shown = make_cohort(150).cohort.set_index("case_id")["volume_ml"]
    saved = table.set_index("Case")["Volume (ml)"].replace("–", np.nan).astype(float)
    np.testing.assert_allclose(saved, shown[saved.index], rtol=1e-5)  # six digits
    page.close()


def saved_table(page: Any, name: str, folder: Path) -> pd.DataFrame:
    with page.expect_download() as download:
        page.click(f"button[data-save=table-{name}]")
    download.value.save_as(folder / f"{name}.csv")
    return pd.read_csv(folder / f"{name}.csv", dtype={"Case": str, "Method": str})


def test_saved_tables_hold_one_number_per_cell(
    browser: Any, cohort_file: Path, tmp_path: Any
) -> None:
    page = browser.new_page()
    page.goto(cohort_file.as_uri())
    page.click("#tab-quality")
    page.evaluate("for (const d of document.querySelectorAll('details')) d.open = true")
    metrics = make_cohort(150).metrics
    general = saved_table(page, "generalisation", tmp_path)
    expected = metrics["generalisation"].groupby(["method", "modes"], sort=False)["surface_mm"]
    np.testing.assert_allclose(general["Surface distance (mm)"], expected.mean(), rtol=1e-5)
    errors = general["Surface distance standard error (mm)"]
    np.testing.assert_allclose(errors, expected.sem(), rtol=1e-4)
    methods = saved_table(page, "methods", tmp_path).set_index("Method")
    compared = metrics["comparison"].set_index("method").loc[methods.index]
    for name, column in {
        "Generalisation, surface distance, mm": "generalisation_surface_mm",
        "Generalisation, surface distance, mm, standard error": "generalisation_surface_se_mm",
        "Specificity: difference from full, low": "specificity_surface_low_mm",
        "Specificity: difference from full, high": "specificity_surface_high_mm",
        "Generalisation: p (Holm)": "generalisation_surface_p",
    }.items():
        others = methods.index != "full"  # to which the others are compared
        found, wanted = methods[name], compared[column]
        np.testing.assert_allclose(found[others], wanted[others], rtol=1e-4, atol=1e-12)
    saved = (tmp_path / "methods.csv").read_text(encoding="utf-8")
    assert not re.search("[±−–]| to ", saved)  # one number per cell, with an ordinary minus
    page.close()


def test_scores_of_the_cases_are_a_table(page: Any, content: Any, tmp_path: Any) -> None:
    page.click("#tab-modes")
    assert f"{SETTINGS.modes} of {content.model.mode_count} modes" in page.inner_text(
        "#panel-modes"
    )
    page.click("#panel-modes summary")
    table = saved_table(page, "scores", tmp_path)
    assert table["Case"].tolist() == list(content.model.case_ids)
    found = table[[f"Mode {mode + 1} (SD)" for mode in range(SETTINGS.modes)]]
    np.testing.assert_allclose(found, content.model.scores[:, : SETTINGS.modes], rtol=1e-5)


def test_the_shape_shown_is_saved_as_stl_and_picture(
    page: Any, content: Any, tmp_path: Any
) -> None:
    page.click("#tab-modes")
    page.locator("#mode-1").fill("-1.5")
    with page.expect_download() as download:
        page.click("#modes-stl")
    assert download.value.suggested_filename == "blobs_mode2_-1.50.stl"
    download.value.save_as(tmp_path / "shape.stl")
    saved = trimesh.load_mesh(tmp_path / "shape.stl")
    expected = content.model.reconstruct(np.array([0, -1.5]))
    solid = trimesh.Trimesh(expected, content.model.faces, process=False)
    np.testing.assert_allclose(saved.triangles, solid.triangles, atol=1e-3)
    np.testing.assert_allclose(saved.face_normals, solid.face_normals, atol=1e-3)
    with page.expect_download() as download:
        page.click("#modes-picture")
    download.value.save_as(tmp_path / "shape.png")
    assert imread(tmp_path / "shape.png")[..., 3].max() == 1


def test_methods_at_a_glance(browser: Any, cohort_file: Path, tmp_path: Path) -> None:
    page = browser.new_page()
    page.goto(cohort_file.as_uri())
    page.click("#tab-quality")
    row = page.locator("#table-methods tbody tr", has_text="S3M tuned")
    assert row.locator(".trait").all_inner_texts() == ["yes", "yes"]
    assert "worse" in row.locator(".verdict").first.inner_text()
    row = page.locator("#table-methods tbody tr", has_text="without groupwise")
    assert "alike" in row.locator(".verdict").first.inner_text()
    with page.expect_download() as download:
        page.click("button[data-save=table-methods]")
    download.value.save_as(tmp_path / "methods.csv")
    table = pd.read_csv(tmp_path / "methods.csv")
    assert table["Method"].tolist()[0] == "full"
    assert len(table) == 14
    assert page.locator("#table-further tbody tr").count() == 15  # and the floor
    page.close()


def test_a_collapsed_map_is_told_on_the_first_tab(
    content: Any, browser: Any, tmp_path: Path
) -> None:
    steps = np.arange(1, 101)
    losses = pd.DataFrame({"step": steps, "total": 1.0 / steps, "map_extent": 0.04})
    path = tmp_path / "index.html"
    write_page(dataclasses.replace(content, training=losses), path, SETTINGS)
    page = browser.new_page()
    page.goto(path.as_uri())
    assert "The map has collapsed" in page.locator("#panel-overview .warning").inner_text()
    page.click("#tab-training")
    assert page.locator("#training-charts .chart").count() == 2
    page.close()


def test_users_text_is_never_code(content: Any, browser: Any, tmp_path: Path) -> None:
    bad = "</script><script>window.owned = 1</script><b id=owned>"
    path = tmp_path / "index.html"
    cohort = content.cohort.assign(warnings=bad)
    check = pd.DataFrame({"case_id": content.aligned.case_ids, "remarks": bad})
    hostile = dataclasses.replace(content, study=bad, cohort=cohort, check=check)
    write_page(hostile, path, SETTINGS)
    page = browser.new_page()
    page.goto(path.as_uri())
    assert page.evaluate("window.owned") is None
    assert page.locator("h1").inner_text().startswith(bad)
    assert page.evaluate("viewer.study.study") == bad
    page.close()


def test_a_study_with_little_to_show_still_makes_a_page(
    content: Any, browser: Any, tmp_path: Path
) -> None:
    bare = dataclasses.replace(
        content, is_synthetic=False, meshes=(), paths=(), metrics={}, landmarks=None, stages=()
    )
    path = tmp_path / "index.html"
    write_page(bare, path, SETTINGS)
    page = browser.new_page()
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(path.as_uri())
    for name in TABS:
        page.click(f"#tab-{name}")
    assert page.locator("p.synthetic").count() == 0
    assert "not computed" in page.locator("#panel-quality").inner_text()
    page.close()
    assert errors == []


def test_a_browser_without_webgl_says_so(browser: Any, file: Path) -> None:
    page = browser.new_page()
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(file.as_uri())
    page.click("#tab-modes")
    assert "WebGL 2 is disabled" in page.locator("#panel-modes").inner_text()
    page.close()
    assert errors == []


def test_the_page_of_a_whole_cohort_stays_small() -> None:
    """22 cases of 4000 vertices, four paths: data and viewer well under 15 MB."""
    payload = build_payload(make_content(4000, 22, 4), ReportSettings())
    data = sum(map(len, payload.blocks.values())) + len(json.dumps(payload.description))
    assert data + (VIEWER / "viewer.js").stat().st_size < 8e6


def test_captions_state_the_floor_of_the_chamfer_distance(content: Any) -> None:
    assert page_html(content, SETTINGS).count("1.25 mm with 500 points") == 1


def test_nothing_is_loaded_from_elsewhere(content: Any) -> None:
    text = page_html(content, SETTINGS)
    assert not re.search(r"(?:src|href)=[\"']?(?:https?:)?//", text)
    assert not re.search(r"@import|url\(\s*[\"']?http", text)

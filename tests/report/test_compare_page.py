"""The page of a comparison, in a real browser."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from synthetic_report import make_comparison

from ssm_pipeline.report.compare_page import write_compare_page
from ssm_pipeline.report.page import page_html, write_page
from ssm_pipeline.report.settings import ReportSettings

SETTINGS = ReportSettings(modes=4)


@pytest.fixture(scope="module")
def file(content: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("compare") / "compare.html"
    write_compare_page(make_comparison(content), content.model, path, "blobs", True, SETTINGS)
    return path


def test_only_what_is_significant_is_coloured(watched_page: Any, file: Path, content: Any) -> None:
    page = watched_page(file)
    upper = (content.model.mean[:, 2] > 0).mean()
    assert page.evaluate("viewer.compare.shownShare()") == pytest.approx(upper)
    page.select_option("#compare-mask", "all")
    assert page.evaluate("viewer.compare.shownShare()") == 1
    page.select_option("#compare-effect", "1")
    page.select_option("#compare-mask", "q")
    assert page.evaluate("viewer.compare.shownShare()") == 0
    assert "age: 14 more (1 SD)" in page.locator("#compare-caption").inner_text()


def test_the_slider_adds_the_effect_to_the_mean(
    watched_page: Any, file: Path, content: Any
) -> None:
    page = watched_page(file)
    page.locator("#compare-scale").fill("2")
    shown = np.array(page.evaluate("[...viewer.compare.positions()]")).reshape(-1, 3)
    effect = make_comparison(content).maps[0].displacement_mm
    np.testing.assert_allclose(shown, content.model.mean + 2 * effect, atol=0.01)


def test_scores_are_drawn_over_groups_and_numbers(
    watched_page: Any, file: Path, content: Any
) -> None:
    page = watched_page(file)
    assert page.locator("#scores-charts .chart").count() == 4
    points = page.locator("#scores-charts .chart").first.locator("circle")
    assert points.count() == len(content.model.case_ids)
    assert page.locator("#scores-charts .chart").first.locator(".mean").count() == 2
    page.select_option("#scores-covariate", "1")
    assert page.locator("#scores-charts .mean").count() == 0
    drawn = page.locator("#scores-charts .chart").first.locator("circle")
    across = [float(drawn.nth(i).get_attribute("cx")) for i in range(drawn.count())]
    ages = make_comparison(content).design.covariates["age"]
    assert np.corrcoef(across, ages)[0, 1] > 0.999


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1280])
def test_nothing_scrolls_sideways(watched_page: Any, file: Path, width: int, scheme: str) -> None:
    page = watched_page(file, width, scheme)
    assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_the_report_has_a_tab_of_all_comparisons(
    watched_page: Any, content: Any, tmp_path: Path
) -> None:
    first = make_comparison(content)
    design = dataclasses.replace(first.design, formula="~ age")
    second = dataclasses.replace(first, design=design, maps=first.maps[1:])
    report = dataclasses.replace(content, comparisons=(first, second))
    write_page(report, tmp_path / "index.html", SETTINGS)
    page = watched_page(tmp_path / "index.html", 390)
    page.click("#tab-compare")
    assert page.locator("#compare-effect option").count() == 2
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    shown = page.evaluate("viewer.compare.shownShare()")
    tables = page.locator(".compared:visible")
    assert "formula ~ sex + age" in tables.inner_text()
    page.select_option("#compare-formula", "1")
    assert page.locator("#compare-effect option").all_inner_texts() == ["age: 14 more (1 SD)"]
    assert page.evaluate("viewer.compare.shownShare()") == 0 != shown
    assert tables.count() == 1
    assert "formula ~ age" in tables.inner_text()
    assert page.locator("#scores-charts .chart").count() == 4


def test_a_report_without_comparisons_has_no_such_tab(content: Any) -> None:
    assert "tab-compare" not in page_html(content, SETTINGS)


def test_users_text_is_never_code(watched_page: Any, content: Any, tmp_path: Path) -> None:
    bad = "</script><script>window.owned = 1</script><b id=owned>"
    comparison = make_comparison(content)
    design = dataclasses.replace(
        comparison.design,
        formula=bad,
        covariates=comparison.design.covariates.assign(sex=bad).rename(columns={"sex": bad}),
    )
    hostile = dataclasses.replace(
        comparison,
        design=design,
        maps=(dataclasses.replace(comparison.maps[0], name=bad),),
        tests=comparison.tests.assign(term=bad),
    )
    write_compare_page(hostile, content.model, tmp_path / "x.html", bad, False, SETTINGS)
    page = watched_page(tmp_path / "x.html")
    assert page.locator("#scores-charts .chart").count() == 4
    assert page.evaluate("window.owned") is None
    assert page.locator("#owned").count() == 0


def test_covariates_of_other_cases_are_refused(content: Any, tmp_path: Path) -> None:
    comparison = make_comparison(content)
    few = dataclasses.replace(comparison.design, covariates=comparison.design.covariates.head(3))
    other = dataclasses.replace(comparison, design=few)
    with pytest.raises(ValueError, match="scores of 8 cases and the comparison covariates of 3"):
        write_compare_page(other, content.model, tmp_path / "x.html", "blobs")

"""The page of new patients, in a real browser."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from synthetic_report import make_fits

from ssm_pipeline.report.fit_page import write_fit_page
from ssm_pipeline.report.settings import ReportSettings

SETTINGS = ReportSettings(modes=4, case_faces=400)


@pytest.fixture(scope="module")
def file(content: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("fit") / "fit.html"
    write_fit_page(make_fits(content), path, "blobs", True, SETTINGS)
    return path


def test_an_ordinary_patient_is_said_to_be_one(watched_page: Any, file: Path) -> None:
    page = watched_page(file)
    verdict = page.locator("#fit-verdict")
    assert verdict.get_attribute("class") == "fine"
    assert verdict.inner_text().startswith("Like the model's cases.")
    assert page.locator("#fit-judged .striking").count() == 0


def test_a_flagged_patient_is_told_with_value_and_threshold(watched_page: Any, file: Path) -> None:
    page = watched_page(file)
    page.select_option("#fit-patient", "1")
    verdict = page.locator("#fit-verdict")
    assert verdict.get_attribute("class") == "warning"
    assert "176 degrees" in verdict.inner_text()
    row = page.locator("#fit-judged .striking")
    assert row.locator("td").all_inner_texts() == ["Rotated by", "176°", "", "45°"]


def test_residuals_and_uncertainty_are_those_of_the_fit(
    watched_page: Any, file: Path, content: Any
) -> None:
    page = watched_page(file)
    page.click("#tab-patients")
    page.locator("button[data-patient='2']").click()  # of whom the top was cut off
    fit = make_fits(content)[2]
    assert page.evaluate("viewer.fit.patient()") == fit.case_id
    residual = np.array(page.evaluate("viewer.fit.values('residual')"))
    np.testing.assert_allclose(residual[fit.observed], fit.distances_mm[fit.observed], atol=1e-3)
    radius = page.evaluate("viewer.fit.values('radius')")
    np.testing.assert_allclose(radius, fit.radius_mm, atol=1e-3)
    assert "not observed" in page.locator("#fit-caption").inner_text()
    page.select_option("#fit-paint", "radius")
    assert "uncertainty" in page.locator("#fit-caption").inner_text()


def test_the_patients_place_among_the_cohort(watched_page: Any, file: Path, content: Any) -> None:
    page = watched_page(file)
    fit = make_fits(content)[0]
    lines = page.locator("#fit-modes .strip-line[role=img]")
    assert lines.count() == SETTINGS.modes
    assert lines.first.locator(".case").count() == len(content.model.case_ids)
    left = float(lines.first.locator(".patient").evaluate("e => e.style.left").rstrip("%"))
    assert left == pytest.approx(50 + 50 * fit.scores[0] / 4, abs=0.01)
    assert f"{abs(fit.scores[0]):.2f} SD" in lines.first.get_attribute("aria-label")


def test_the_picture_follows_the_choice(watched_page: Any, file: Path) -> None:
    page = watched_page(file)
    canvas = page.locator("#fit-stage canvas")
    page.evaluate("viewer.fit.drawNow()")
    seen = [canvas.screenshot()]
    for kind, choice in [("paint", "radius"), ("show", "reconstruction"), ("show", "patient")]:
        page.select_option(f"#fit-{kind}", choice)
        page.evaluate("viewer.fit.drawNow()")
        seen.append(canvas.screenshot())
    assert len(set(seen)) == len(seen)


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1280])
def test_nothing_scrolls_sideways(watched_page: Any, file: Path, width: int, scheme: str) -> None:
    page = watched_page(file, width, scheme)
    for name in ("fit", "patients"):
        page.click(f"#tab-{name}")
        assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_one_patient_needs_no_list(watched_page: Any, content: Any, tmp_path: Path) -> None:
    write_fit_page(make_fits(content)[:1], tmp_path / "fit.html", "blobs", False, SETTINGS)
    page = watched_page(tmp_path / "fit.html")
    assert page.locator("#fit-patient").count() == 0
    assert not page.locator("[role=tablist]").is_visible()
    assert page.locator("#fit-verdict").inner_text().startswith("Like the model's cases.")


def test_users_text_is_never_code(watched_page: Any, content: Any, tmp_path: Path) -> None:
    bad = "</script><script>window.owned = 1</script><b id=owned>"
    fit = dataclasses.replace(make_fits(content)[0], case_id=bad, remarks=(bad,))
    fits = [fit, *make_fits(content)[1:]]
    write_fit_page(fits, tmp_path / "fit.html", bad, False, SETTINGS)
    page = watched_page(tmp_path / "fit.html")
    page.click("#tab-patients")
    assert page.evaluate("window.owned") is None
    assert page.locator("#owned").count() == 0


def test_no_patient_is_no_page(content: Any, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no fitted patient"):
        write_fit_page([], tmp_path / "fit.html", "blobs")

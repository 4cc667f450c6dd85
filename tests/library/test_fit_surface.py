"""`fit` gives the flags of `workflow fit`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from cohorts import bumpy_cohort, surfaces_of

import ssm_pipeline as ssm
from ssm_pipeline.fitting import patient
from ssm_pipeline.fitting.typicality import judge


@pytest.fixture(scope="module")
def cohort() -> Any:
    """A model of ten cases, and a surface of the same kind."""
    shapes = bumpy_cohort(11, seed=3, rough_mm=0.8)
    return ssm.build_model(shapes.subset(range(10))), surfaces_of(shapes)[10]


def kinds(report: ssm.FitReport) -> list[str]:
    return [flag.split(":")[0] for flag in report.flags]


def test_a_surface_of_the_kind_has_no_flag(cohort: Any) -> None:
    model, surface = cohort
    report = ssm.fit(model, surface)
    assert report.flags == ()
    assert np.all(report.low < report.scores)
    assert report.vertices.shape == model.mean.shape


def test_what_is_wrong_with_a_surface_is_flagged(cohort: Any) -> None:
    model, surface = cohort
    faces = surface.faces
    metres = ssm.Mesh(surface.vertices / 1000, faces, "metres")
    assert "units" in kinds(ssm.fit(model, metres))
    flipped = ssm.Mesh(surface.vertices, faces[:, ::-1], "inside out")
    report = ssm.fit(model, flipped)
    assert kinds(report) == ["inside out"]
    np.testing.assert_allclose(report.scores, ssm.fit(model, surface).scores)  # as if it were right
    image = ssm.Mesh(surface.vertices * [-1, 1, 1], faces[:, ::-1], "mirrored")
    assert "mirrored" in kinds(ssm.fit(model, image))


def test_the_models_own_cases_are_fitted_once(cohort: Any, monkeypatch: Any) -> None:
    model, surface = cohort
    ssm.fit(model, surface)
    from ssm_pipeline.library import fit_surface

    monkeypatch.setattr(fit_surface, "cross_validate", lambda *a: pytest.fail("fitted again"))
    ssm.fit(model, surface)
    with pytest.raises(ssm.StudyError, match="has no mesh among 1"):
        ssm.fit(model, surface, meshes=[surface])


def test_a_model_without_cases_is_judged_by_shapes_drawn_from_it(
    cohort: Any, monkeypatch: Any
) -> None:
    model, surface = cohort
    seen = []

    def spy(*arguments: Any) -> Any:
        seen.append(arguments[-1])
        return judge(*arguments)

    monkeypatch.setattr(patient, "judge", spy)
    ssm.fit(model.truncate(2), surface)
    assert seen[0].case_ids[0] == "drawn_000"

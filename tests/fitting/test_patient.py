"""New patients of a made-up cohort, and what is none of its kind."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cohorts import TURN, bumpy_cohort, surfaces_of
from scipy.stats import norm
from shapes import blob

from ssm_pipeline import storage
from ssm_pipeline.fitting import completion, patient
from ssm_pipeline.fitting.completion import COVERAGE, calibrated_radius, cut_as_observed
from ssm_pipeline.fitting.cross_validation import (
    CrossValidation,
    LeftOutFits,
    cross_validate,
    model_without,
    score_inflation,
)
from ssm_pipeline.fitting.model_fit import fit_model
from ssm_pipeline.fitting.partial import without_faces
from ssm_pipeline.fitting.patient import fit_patient
from ssm_pipeline.fitting.pose_search import mirrored
from ssm_pipeline.fitting.typicality import TAIL, judge, tail_of, without_outliers
from ssm_pipeline.fitting.yardstick import Yardstick
from ssm_pipeline.geometry.distances import SurfaceTarget
from ssm_pipeline.records import CorrespondedShapes, Mesh, StudyError
from ssm_pipeline.shape_model.alignment import align
from ssm_pipeline.shape_model.pca import pca_model


@pytest.fixture(scope="module")
def cohort() -> Any:
    """Ten cases of a rough cohort, two more of the same, and the cross-validation of the ten."""
    shapes = bumpy_cohort(12, seed=3, rough_mm=0.8)
    kept = shapes.subset(range(10))
    new = surfaces_of(shapes)[10:]
    reference = cross_validate(kept, surfaces_of(kept))
    return Yardstick(pca_model(align(kept)[0]), kept, surfaces_of(kept), reference), new


def flags_of(cohort: Any, surface: Any) -> Any:
    report = fit_patient(cohort[0], surface)
    return [flag.split(":")[0] for flag in report.typicality.flags]


def test_a_new_case_of_the_kind_is_fitted_and_not_flagged(cohort: Any) -> None:
    yardstick, new = cohort
    surface = Mesh(TURN.apply(new[0].vertices), new[0].faces, "new")
    report = fit_patient(yardstick, surface)
    assert report.typicality.flags == ()
    assert report.mean_mm < 2.0
    assert report.observed_share == 1.0
    assert np.all(report.low < report.scores)
    assert np.all(report.scores < report.high)
    # The radius is meant to hold 90 % of the vertices; one case's share scatters about that.
    assert (report.distances_mm <= report.radius_mm).mean() > 0.75
    assert report.typicality.residual.threshold > yardstick.reference.residual_mm.max()


def test_by_matched_points_the_reconstruction_is_the_same_shape(cohort: Any) -> None:
    yardstick, new = cohort
    matched = new[1].vertices[: len(yardstick.model.mean)]
    report = fit_patient(yardstick, new[1], matched=matched)
    own = fit_patient(yardstick, new[1])
    assert (report.by, own.by) == ("matcher", "model")
    assert np.linalg.norm(report.vertices - own.vertices, axis=1).mean() < 2.0


def test_upside_down_mirrored_and_other_things_are_flagged(cohort: Any) -> None:
    new = cohort[1][0]
    down = Mesh(new.vertices * [1.0, -1.0, -1.0] + [0, 0, 500.0], new.faces, "down")
    assert flags_of(cohort, down) == ["turned"]
    assert "mirrored" in flags_of(cohort, mirrored(new))
    small = Mesh(0.4 * new.vertices, new.faces, "small")
    assert {"unlike the model", "extreme"} & set(flags_of(cohort, small))
    ball = Mesh(blob(1).vertices * [1.5, 0.8, 0.7], blob(1).faces, "other")
    assert flags_of(cohort, ball)


def test_a_part_is_completed_with_intervals_that_hold(cohort: Any) -> None:
    yardstick, new = cohort
    covered = []
    for whole in new:
        height = whole.vertices[:, 2]
        top = height > height.max() - np.ptp(height) / 3
        part = without_faces(whole, top[whole.faces].any(axis=1))
        report = fit_patient(yardstick, part)
        unseen = ~report.observed
        assert 0.1 < unseen.mean() < 0.5
        assert report.sd_mm[unseen].mean() > report.sd_mm[~unseen].mean()
        errors = SurfaceTarget.of(whole.vertices, whole.faces).distances_to(report.vertices)
        covered.append((errors <= report.radius_mm)[unseen])
        assert errors[unseen].mean() < 4.0
        assert "missing" in report.remarks[0]
    # Two cases, so two or three independent errors: far from 90 % would be wrong, near it is not
    # to be had.
    assert abs(np.concatenate(covered).mean() - COVERAGE) < 0.25


def test_the_radius_holds_nine_in_ten_vertices_of_a_new_case() -> None:
    """Errors as of real cases: one case is far off everywhere, another nowhere, and the fits state
    half of it. Seen vertices are three times nearer."""
    generator = np.random.default_rng(0)
    cases, count, held = 12, 300, []
    observed = np.arange(count) < 200
    far = np.where(observed, 1.0, 3.0)
    for _ in range(300):
        scale = np.exp(0.6 * generator.standard_normal((cases + 1, 1)))
        errors = scale * far * np.abs(generator.standard_normal((cases + 1, count)))
        stated = np.tile(scale / 2, count)
        left_out = LeftOutFits(errors[1:], stated[1:] ** 2, np.zeros((cases, 2)))
        radius = calibrated_radius(stated[0] ** 2, left_out, observed)
        within = errors[0] <= radius
        held.append([within[observed].mean(), within[~observed].mean()])
    # A share of 100 vertices has a standard error of 0.03, the mean of 300 of 0.002.
    np.testing.assert_allclose(np.mean(held, axis=0), COVERAGE, atol=0.008)
    assert np.std(held, axis=0).max() < 0.05  # each case, whatever its scale: it was stated


def test_a_cut_case_keeps_the_part_that_was_seen() -> None:
    shapes = bumpy_cohort(1)
    (mesh,) = surfaces_of(shapes)
    matched = Mesh(shapes.vertices[0], shapes.faces, "c0")
    part = cut_as_observed(mesh, matched, matched.vertices[:, 2] < 10)
    ends = matched.vertices[matched.faces[:, :2]]
    edge = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).max()
    assert part.vertices[:, 2].max() < 10 + 1e-9
    assert part.vertices[:, 2].max() > 10 - edge
    assert len(part.faces) < len(mesh.faces)
    assert cut_as_observed(mesh, matched, np.ones(len(matched.vertices), bool)) is mesh


def test_each_case_is_fitted_by_a_model_that_does_not_know_it(cohort: Any) -> None:
    shapes, reference = cohort[0].shapes, cohort[0].reference
    model, _ = model_without(shapes, 3, False, shapes.case_ids)
    assert shapes.case_ids[3] not in model.case_ids
    # Were the case in the model, nothing but the triangulation would be left of it.
    assert reference.residual_mm.min() > 0.2
    assert reference.turned_deg.max() < 10


def test_the_cross_validation_is_stored_and_read_again(cohort: Any, tmp_path: Path) -> None:
    reference = cohort[0].reference
    storage.save(reference, tmp_path / "reference.npz")
    again = storage.load(CrossValidation, tmp_path / "reference.npz")
    np.testing.assert_array_equal(again.residual_mm, reference.residual_mm)
    np.testing.assert_array_equal(again.left_out.distances_mm, reference.distances_mm)


def test_a_patients_other_case_does_not_help_to_judge() -> None:
    """Two nearly equal cases a patient: by a model with the other, each is fitted at once."""
    shapes = bumpy_cohort(8, seed=3, rough_mm=0.8)
    twins = np.random.default_rng(0).normal(0, 0.02, shapes.vertices.shape)
    both = CorrespondedShapes(
        np.concatenate([shapes.vertices, shapes.vertices + twins]),
        shapes.faces,
        tuple(f"{name}{side}" for side in "lr" for name in shapes.case_ids),
        f"{shapes.case_ids[0]}l",
    )
    patients = [*shapes.case_ids, *shapes.case_ids]
    model, _ = model_without(both, 3, False, patients)
    assert {patients[both.case_ids.index(name)] for name in model.case_ids} == {
        *shapes.case_ids
    } - {patients[3]}
    alone = cross_validate(shapes, surfaces_of(shapes)).residual_mm
    found = cross_validate(both, surfaces_of(both), patients=patients).residual_mm
    assert np.median(found) > 0.8 * np.median(alone)
    assert np.median(cross_validate(both, surfaces_of(both)).residual_mm) < 0.5 * np.median(alone)


def test_five_cases_are_too_few_to_judge_by() -> None:
    shapes = bumpy_cohort(5)
    with pytest.raises(StudyError, match="and the model has 5, of 5"):
        cross_validate(shapes, surfaces_of(shapes))


def test_one_in_a_hundred_of_the_kind_is_flagged() -> None:
    """Draw the reference and the new one from one log-normal distribution, again and again."""
    generator = np.random.default_rng(1)
    draws = np.exp(generator.normal(1.0, 0.4, (4000, 21)))
    flagged = np.mean([tail_of(row[0], row[1:]).is_flagged for row in draws])
    # Standard error √(0.01 · 0.99 / 4000) = 0.0016; four of them.
    assert abs(flagged - TAIL) < 0.0064
    judged = tail_of(3.0, draws[0, 1:])
    assert tail_of(judged.threshold, draws[0, 1:]).tail == pytest.approx(TAIL)


def test_a_child_is_flagged_by_a_model_without_size(cohort: Any) -> None:
    """Residual and shape are those of any other, so that nothing but the size could tell."""
    reference = cohort[0].reference
    sizes = np.exp(np.random.default_rng(0).normal(0, 0.1, len(reference.size)))
    without_size = dataclasses.replace(reference, size=sizes)
    usual = (float(reference.residual_mm[0]), float(reference.mahalanobis[0]), 0.0, 2.0)
    (flag,) = judge(*usual, 0.5, without_size).flags
    assert flag.startswith("size: 0.50 times the mean")
    assert judge(*usual, 1.05, without_size).flags == ()
    assert judge(*usual, 1.0, reference).flags == ()  # a model with size: it is a mode


def test_score_inflation_undoes_a_wrong_standard_deviation() -> None:
    z = 2.0 * norm.ppf((np.arange(10_000) + 0.5) / 10_000)
    assert score_inflation(z) == pytest.approx(2.0, rel=0.01)
    assert score_inflation(z / 10) == 1.0


def test_a_copy_in_the_cohort_does_not_raise_the_threshold() -> None:
    """By a model that holds its copy, a case is fitted at once: such a residual sets nothing."""
    generator = np.random.default_rng(0)
    residuals = np.exp(generator.normal(-0.8, 0.2, 12))
    usual = tail_of(2.0, residuals).threshold
    with_copies = tail_of(2.0, np.append(residuals, [0.002, 0.003]))
    assert with_copies.threshold == pytest.approx(usual)
    assert with_copies.is_flagged
    # Nor does one case with a wrong mask hide the next one.
    assert tail_of(5.0, np.append(residuals, 8.0)).is_flagged
    turned = np.append(generator.uniform(0, 12, 12), 175.0)
    assert without_outliers(turned, 3.0).max() < 12


def test_intervals_of_scores_are_widened_by_the_cross_validated_errors(
    cohort: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    yardstick, new = cohort
    fitted = fit_model(yardstick.model, new[0], points=200, steps=8)
    monkeypatch.setattr(patient, "best_fit", lambda *_: (fitted, 0.0, 2.0))
    z = norm.ppf((np.arange(500) + 0.5) / 500)
    errors = np.tile(2.0 * z[:, None], (1, yardstick.reference.score_errors.shape[1]))
    reference = dataclasses.replace(yardstick.reference, score_errors=errors)
    report = fit_patient(dataclasses.replace(yardstick, reference=reference), new[0])
    half = (report.high - report.low) / 2
    np.testing.assert_allclose(half, 2.0 * norm.isf(0.025) * fitted.score_sd, rtol=0.01)


def test_a_part_is_judged_without_the_patients_other_cases(
    cohort: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The cut cases are fitted by models without the cases of their patient, too."""
    yardstick, new = cohort
    whole = fit_model(yardstick.model, new[0], points=200, steps=8)
    part = dataclasses.replace(whole, observed=whole.vertices[:, 2] < 0)
    monkeypatch.setattr(patient, "best_fit", lambda *_: (part, 0.0, 2.0))
    held_together = [f"p{number // 2}" for number in range(10)]
    models: list[list[str]] = []

    def without(shapes: Any, index: Any, with_scale: Any, patients: Any) -> Any:
        models.append([patients[index], *(p for p in patients if p != patients[index])])
        return model_without(shapes, index, with_scale, patients)

    monkeypatch.setattr(completion, "model_without", without)
    monkeypatch.setattr(completion, "POINTS", 100)
    monkeypatch.setattr(completion, "STEPS", 2)
    fit_patient(dataclasses.replace(yardstick, patients=held_together), new[0])
    assert [each[0] for each in models] == held_together
    assert all(len(each) == 9 for each in models)  # itself, and eight cases of other patients

from typing import Any

import numpy as np
import pandas as pd
import pytest
from synthetic_shapes import wavy_cohort

from ssm_pipeline.evaluation import nearest_case
from ssm_pipeline.evaluation.aligned_cohort import align_cohort
from ssm_pipeline.evaluation.comparison import compare
from ssm_pipeline.evaluation.evaluate import Scoring, evaluate_method
from ssm_pipeline.evaluation.model_quality import generalisation, held_out_folds
from ssm_pipeline.evaluation.nearest_case import nearest_other_cases
from ssm_pipeline.evaluation.settings import EvaluationSettings
from ssm_pipeline.evaluation.surface_fits import fits_to_held_out
from ssm_pipeline.records import CorrespondedShapes, Mesh

SETTINGS = EvaluationSettings(
    points=162, samples=20, surface_samples=5, jackknife_samples=4, screening_points=40
)


@pytest.fixture(scope="module")
def cohort() -> Any:
    return wavy_cohort(5)


@pytest.fixture(scope="module")
def scored(cohort: Any) -> Any:
    shapes, meshes = cohort
    return evaluate_method("ours", shapes, meshes, Scoring(SETTINGS, seed=7))


def test_all_tables_with_method_and_seed(scored: Any) -> None:
    assert set(scored.tables) == {
        "compactness",
        "generalisation",
        "generalisation_mean",
        "specificity",
        "specificity_draws",
        "specificity_jackknife",
        "surface_fits",
        "correspondence",
    }
    fitted = ["fitted_surface_mm", "fitted_hd95_mm", "fitted_flipped_percent"]
    assert scored.tables["correspondence"][fitted].isna().all(axis=None)  # none was given
    for table in scored.tables.values():
        assert table["method"].eq("ours").all()
        assert table["seed"].eq(7).all()
        assert not table.drop(columns=fitted, errors="ignore").isna().any(axis=None)
    assert scored.tables["generalisation"]["modes"].max() == 3
    assert scored.tables["specificity"]["modes"].max() == 4


def test_same_numbers_whatever_the_order_of_meshes_and_the_processes(
    cohort: Any, scored: Any
) -> None:
    shapes, meshes = cohort
    again = evaluate_method("ours", shapes, meshes[::-1], Scoring(SETTINGS, seed=7, jobs=2))
    for name, table in scored.tables.items():
        pd.testing.assert_frame_equal(table, again.tables[name])


def test_a_thinned_curve_can_still_be_compared(cohort: Any) -> None:
    """Generalisation has a mode fewer than specificity: two even choices of numbers don't meet."""
    settings = SETTINGS.model_copy(update={"mode_counts": 2, "samples": 5, "surface_samples": 2})
    shapes, meshes = cohort
    metrics = evaluate_method("ours", shapes, meshes, Scoring(settings, seed=7))
    assert metrics.tables["generalisation"]["modes"].unique().tolist() == [1, 3]
    assert metrics.tables["specificity"]["modes"].tolist() == [1, 3, 4]
    table = compare({"ours": metrics}, "ours", 100, np.random.default_rng(0))
    assert table["modes"].item() == 3


def test_a_bad_fit_shows_though_its_points_were_carried_onto_the_case(cohort: Any) -> None:
    shapes, meshes = cohort
    blown_up = shapes.vertices + 3 * (shapes.vertices - shapes.vertices.mean(axis=1)[:, None]) / 50
    metrics = evaluate_method("ours", shapes, meshes, Scoring(SETTINGS, seed=7), fitted=blown_up)
    fits = metrics.tables["correspondence"]
    assert (fits["surface_mm"] < 1e-6).all()
    assert (fits["fitted_surface_mm"] > 1).all()


def test_the_model_is_scored_at_the_modes_that_hold_95_percent(cohort: Any) -> None:
    settings = SETTINGS.model_copy(
        update={"mode_counts": 1, "jackknife_samples": 0, "fit_surfaces": False}
    )
    shapes, meshes = cohort
    metrics = evaluate_method("ours", shapes, meshes, Scoring(settings, seed=7))
    held = metrics.tables["compactness"].query("share >= 0.95")["modes"].min()
    assert held in set(metrics.tables["specificity"]["modes"])
    assert min(held, 3) in set(metrics.tables["generalisation"]["modes"])
    assert {"specificity_jackknife", "surface_fits"}.isdisjoint(metrics.tables)


def test_a_case_is_nearest_to_the_one_most_like_it(cohort: Any) -> None:
    _, meshes = cohort
    near = Mesh(meshes[0].vertices + 0.5, meshes[0].faces, "near")
    generator = np.random.default_rng(0)
    table = nearest_other_cases([*meshes, near], SETTINGS, generator).set_index("case_id")
    assert table.loc["near", "nearest_by_surface"] == meshes[0].case_id
    assert table.loc[meshes[0].case_id, "nearest_by_chamfer"] == "near"
    assert table.loc["near", "surface_mm"] < 1
    assert (table["chamfer_floor_mm"] > 0).all()


def test_of_many_cases_some_are_asked_and_compared_in_full_with_the_nearest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _, meshes = wavy_cohort(15)
    whole = nearest_other_cases(meshes, SETTINGS, np.random.default_rng(0))
    monkeypatch.setattr(nearest_case, "CANDIDATES", len(meshes))
    in_full = nearest_other_cases(meshes, SETTINGS, np.random.default_rng(0))
    pd.testing.assert_frame_equal(whole, in_full)
    monkeypatch.setattr(nearest_case, "MOST_ASKED", 4)
    some = nearest_other_cases(meshes, SETTINGS, np.random.default_rng(0))
    pd.testing.assert_frame_equal(some, in_full.iloc[[0, 5, 9, 14]].reset_index(drop=True))


def test_a_patients_twin_is_unknown_to_the_model() -> None:
    """Left and right of a patient are nearly equal: what the model of the others cannot explain."""
    shapes, meshes = wavy_cohort(5)
    twins = shapes.vertices + 0.05
    ids = (*shapes.case_ids, *(f"{case_id}_right" for case_id in shapes.case_ids))
    both = CorrespondedShapes(
        np.concatenate([shapes.vertices, twins]), shapes.faces, ids, shapes.template_id
    )
    meshes = [Mesh(v, both.faces, i) for v, i in zip(both.vertices, ids, strict=True)]
    patients = dict(zip(ids, [*shapes.case_ids] * 2, strict=True))
    settings = SETTINGS.model_copy(
        update={"fit_surfaces": False, "samples": 5, "surface_samples": 2}
    )
    scoring = Scoring(settings, seed=7, patients=patients)
    metrics = evaluate_method("ours", both, meshes, scoring)
    found = metrics.tables["generalisation"]
    cohort, _ = align_cohort(both, meshes)
    folds = held_out_folds(10, 0, 7, [patients[case_id] for case_id in ids])
    generator = np.random.default_rng(7).spawn(4)[0]
    expected = generalisation(cohort, settings, generator, folds, [found["modes"].max()])
    np.testing.assert_allclose(found["surface_mm"], expected["surface_mm"])
    assert found["patient"].tolist() == [patients[case_id] for case_id in found["case_id"]]
    assert set(metrics.tables["specificity_jackknife"]["left_out"]) == set(shapes.case_ids)


def test_a_model_is_fitted_to_a_case_that_it_does_not_know() -> None:
    """What of a case lies outside the others' span stays between its surface and the fit."""
    shapes, _ = wavy_cohort(6, modes=2)
    directions = shapes.vertices[0] - shapes.vertices[0].mean(axis=0)
    out = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    vertices = shapes.vertices.copy()
    vertices[3] += 6 * np.sin(8 * directions[:, :1] / 50) * out  # no other case has such a wave
    odd = CorrespondedShapes(vertices, shapes.faces, shapes.case_ids, shapes.template_id)
    meshes = [Mesh(v, shapes.faces, i) for v, i in zip(vertices, shapes.case_ids, strict=True)]
    cohort, _ = align_cohort(odd, meshes)
    folds = held_out_folds(6, 0, 0)
    fits = fits_to_held_out(cohort, folds, 4).set_index("case_id")["surface_mm"]
    rebuilt = generalisation(cohort, SETTINGS, np.random.default_rng(0), folds)
    at_most_modes = rebuilt[rebuilt["modes"] == 4].set_index("case_id")["surface_mm"]
    # A model that knew the case would have the wave as a mode, and leave nothing.
    assert fits["case_03"] > 0.5 * at_most_modes["case_03"] > 0.5

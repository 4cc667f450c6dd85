
import numpy as np
import pandas as pd
import pytest
from synthetic_shapes import wavy_cohort

from ssm_pipeline.evaluation.comparison import compare
from ssm_pipeline.evaluation.evaluate import evaluate_method
from ssm_pipeline.evaluation.settings import EvaluationSettings

SETTINGS = EvaluationSettings(points=162, samples=20, surface_samples=5)


@pytest.fixture(scope="module")
def cohort():
    return wavy_cohort(5)


@pytest.fixture(scope="module")
def scored(cohort):
    return evaluate_method("ours", *cohort, SETTINGS, seed=7)


def test_all_tables_with_method_and_seed(scored):
    assert set(scored.tables) == {
        "compactness",
        "generalisation",
        "generalisation_mean",
        "specificity",
        "correspondence",
    }
    for table in scored.tables.values():
        assert table["method"].eq("ours").all()
        assert table["seed"].eq(7).all()
        assert not table.isna().any(axis=None)
    assert scored.tables["generalisation"]["modes"].max() == 3
    assert scored.tables["specificity"]["modes"].max() == 4


def test_same_numbers_whatever_the_order_of_meshes_and_the_processes(cohort, scored):
    shapes, meshes = cohort
    again = evaluate_method("ours", shapes, meshes[::-1], SETTINGS, seed=7, jobs=2)
    for name, table in scored.tables.items():
        pd.testing.assert_frame_equal(table, again.tables[name])


def test_a_thinned_curve_can_still_be_compared(cohort):
    """Generalisation has a mode fewer than specificity: two even choices of numbers don't meet."""
    settings = SETTINGS.model_copy(update={"mode_counts": 2, "samples": 5, "surface_samples": 2})
    metrics = evaluate_method("ours", *cohort, settings, seed=7)
    assert metrics.tables["generalisation"]["modes"].unique().tolist() == [1, 3]
    assert metrics.tables["specificity"]["modes"].tolist() == [1, 3, 4]
    table = compare({"ours": metrics}, "ours", 100, np.random.default_rng(0))
    assert table["modes"].item() == 3

"""Intervals over cases, against what repeated cohorts give."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation
from statsmodels.stats.multitest import multipletests
from synthetic_shapes import wavy_cohort

from ssm_pipeline.evaluation import paired
from ssm_pipeline.evaluation.aligned_cohort import AlignedCohort
from ssm_pipeline.evaluation.paired import holm, over_cases, over_left_out_cases
from ssm_pipeline.evaluation.settings import EvaluationSettings
from ssm_pipeline.evaluation.specificity_jackknife import without_each
from ssm_pipeline.evaluation.unseen import unseen_specificity
from ssm_pipeline.records import Mesh
from ssm_pipeline.shape_model.alignment import align


def test_cases_are_paired_by_name_and_not_by_row() -> None:
    base = pd.DataFrame({"case_id": list("abcd"), "x_mm": [1.0, 2, 3, 4]})
    shuffled = base.sample(frac=1, random_state=1)
    result = over_cases(shuffled, base, "x_mm", 500, np.random.default_rng(0))
    assert result.low == result.high == result.value == 0
    assert result.p == 1


def test_a_bootstrap_in_parts_is_the_bootstrap(monkeypatch: pytest.MonkeyPatch) -> None:
    ids = [str(number) for number in range(30)]
    base = pd.DataFrame({"case_id": ids, "x_mm": 0.0})
    own = base.assign(x_mm=np.random.default_rng(1).normal(0.2, 1, 30))
    whole = over_cases(own, base, "x_mm", 500, np.random.default_rng(0))
    monkeypatch.setattr(paired, "AT_A_TIME", 70)
    assert over_cases(own, base, "x_mm", 500, np.random.default_rng(0)) == whole


def test_interval_covers_the_truth_as_often_as_it_says() -> None:
    generator = np.random.default_rng(0)
    ids, covered, found = [str(i) for i in range(40)], 0, 0
    base = pd.DataFrame({"case_id": ids, "x_mm": 5.0})
    for _ in range(200):
        own = base.assign(x_mm=5 + generator.normal(-0.3, 1, 40))
        interval = over_cases(own, base, "x_mm", 400, generator)
        covered += interval.low <= -0.3 <= interval.high
        nothing = base.assign(x_mm=5 + generator.normal(0, 1, 40))
        found += over_cases(nothing, base, "x_mm", 400, generator).p < 0.05
    assert 0.88 <= covered / 200 <= 0.99  # 95 %; percentile intervals are a little narrow
    assert found / 200 <= 0.12  # and its p a little small


def test_intervals_hold_where_a_patient_has_two_cases() -> None:
    """Both sides of a patient differ alike: twelve patients are twelve, not twenty-four."""
    generator = np.random.default_rng(2)
    ids = [f"{number:02d}" for number in range(24)]
    base = pd.DataFrame({"case_id": ids, "x_mm": 0.0})
    shared, own = np.sqrt([0.8, 0.2])
    covered = {"patient": 0, "case": 0}
    for _ in range(200):
        of_patients = generator.normal(size=12).repeat(2)
        cases = base.assign(x_mm=shared * of_patients + own * generator.normal(size=24))
        for whose, table in (
            ("patient", cases.assign(patient=np.arange(12).repeat(2))),
            ("case", cases),
        ):
            interval = over_cases(table, base, "x_mm", 400, generator)
            covered[whose] += interval.low <= 0 <= interval.high
    assert covered["patient"] / 200 >= 0.88
    assert covered["case"] / 200 <= 0.86  # what it would be worth to forget it


def test_jackknife_covers_the_truth_as_often_as_it_says() -> None:
    """A difference that is the mean of what each case contributes: its error is known, σ/√N."""
    generator, covered, count = np.random.default_rng(1), 0, 25
    ids = [f"{i:02d}" for i in range(count)]
    zero = pd.DataFrame(
        [{"left_out": i, "half": half, "surface_mm": 0.0} for i in ids for half in (0, 1)]
    )
    for _ in range(200):
        of_cases = generator.normal(0.3, 1.0, count)
        left_out = (of_cases.sum() - of_cases) / (count - 1)
        # Each half of the draws with noise of its own, which is no spread of cases.
        noisy = left_out[:, None] + generator.normal(0, 0.02, (count, 2))
        table = zero.assign(surface_mm=noisy.ravel())
        drawn = of_cases.mean() + generator.normal(0, 0.1, 50)
        interval = over_left_out_cases(table, zero, drawn, np.zeros(50))
        covered += interval.low <= 0.3 <= interval.high
    assert 0.88 <= covered / 200 <= 0.99


def test_holm_by_hand() -> None:
    # Sorted 0.01, 0.02, 0.04: times 3, 2, 1 and never falling.
    assert holm([0.04, np.nan, 0.01, 0.02])[[0, 2, 3]] == pytest.approx([0.04, 0.03, 0.04])
    assert np.isnan(holm([0.04, np.nan])[1])
    assert holm([0.9, 0.8]).tolist() == [1.0, 1.0]


def test_models_without_each_case_do_not_look_at_its_mesh() -> None:
    shapes, meshes = wavy_cohort(6, subdivisions=2)
    aligned, _ = align(shapes)
    settings = EvaluationSettings(points=100, jackknife_samples=6, screening_points=40)
    own = [
        type(mesh)(vertices, mesh.faces, mesh.case_id)
        for mesh, vertices in zip(meshes, aligned.vertices, strict=True)
    ]
    table = without_each(AlignedCohort(aligned, own), 3, settings, np.random.default_rng(0))
    assert table["left_out"].tolist() == [case for case in aligned.case_ids for _ in (0, 1)]
    far = [*own[:-1], type(own[-1])(own[-1].vertices + 1e4, own[-1].faces, own[-1].case_id)]
    moved = without_each(AlignedCohort(aligned, far), 3, settings, np.random.default_rng(0))
    last = table["left_out"] == aligned.case_ids[-1]
    assert moved["surface_mm"][last].tolist() == table["surface_mm"][last].tolist()


def test_models_without_each_case_do_not_know_its_shape() -> None:
    """The last case as a monster would change every draw of a model that knows it."""
    shapes, meshes = wavy_cohort(6, subdivisions=2)
    aligned = align(shapes)[0]
    own = [
        dataclasses.replace(mesh, vertices=vertices)
        for mesh, vertices in zip(meshes, aligned.vertices, strict=True)
    ]
    settings = EvaluationSettings(points=100, jackknife_samples=6, screening_points=400)
    vertices = aligned.vertices.copy()
    vertices[-1] *= [1.0, 1.0, 3.0]
    tables = [
        without_each(AlignedCohort(each, own), 3, settings, np.random.default_rng(0))
        for each in (aligned, dataclasses.replace(aligned, vertices=vertices))
    ]
    last = tables[0]["left_out"] == aligned.case_ids[-1]
    one, other = (table["surface_mm"].to_numpy() for table in tables)
    # Only the points that choose the candidates lie on the mean of all cases.
    np.testing.assert_allclose(one[last], other[last], rtol=1e-6)
    assert not np.isclose(one[~last], other[~last], rtol=1e-2).any()


def test_models_without_a_case_are_aligned_again() -> None:
    """Shapes that lie anywhere give the numbers of aligned ones: a model aligns its own cases."""
    shapes, meshes = wavy_cohort(6, subdivisions=2)
    settings = EvaluationSettings(points=100, jackknife_samples=6, screening_points=400)
    settings = settings.model_copy(update={"surface_samples": 6})
    aligned = align(shapes)[0]
    turn = Rotation.from_euler("z", 40, degrees=True).as_matrix()
    vertices = aligned.vertices.copy()
    vertices[1] = vertices[1] @ turn.T + 20
    cohorts = [
        AlignedCohort(
            dataclasses.replace(aligned, vertices=each),
            [dataclasses.replace(m, vertices=v) for m, v in zip(meshes, each, strict=True)],
        )
        for each in (aligned.vertices, vertices)
    ]
    held_out = np.array([4, 5])
    for found in (
        [without_each(c, 3, settings, np.random.default_rng(0))["surface_mm"] for c in cohorts],
        [
            unseen_specificity(c, held_out, 2, settings, np.random.default_rng(0))["surface_mm"]
            for c in cohorts
        ],
    ):
        np.testing.assert_allclose(found[0], found[1], rtol=0.05)


def test_an_interval_of_few_cases_has_their_degrees_of_freedom() -> None:
    """Draws without noise, four cases: the interval is Student's with three degrees of freedom."""
    left_out = [1.0, 1.3, 0.8, 1.1]
    rows = [
        {"left_out": str(case), "half": half, "surface_mm": value}
        for case, value in enumerate(left_out)
        for half in (0, 1)
    ]
    table = pd.DataFrame(rows)
    drawn = np.full(50, 2.0)
    found = over_left_out_cases(table, table.assign(surface_mm=0.0), drawn, np.zeros(50))
    error = np.sqrt(3 / 4 * np.sum((np.array(left_out) - np.mean(left_out)) ** 2))
    assert (found.high - found.low) / 2 == pytest.approx(stats.t.ppf(0.975, 3) * error, rel=1e-9)
    assert found.value == 2.0
    assert found.p == pytest.approx(2 * stats.t.sf(2.0 / error, 3))


def test_holm_is_that_of_statsmodels() -> None:
    p = np.random.default_rng(0).uniform(0, 0.2, 9)
    np.testing.assert_allclose(holm(p.tolist()), multipletests(p, method="holm")[1])


def test_seen_and_unseen_are_the_nearest_of_equally_many() -> None:
    """The kept meshes are copies, one near and five far: of as many as held out, rarely the near
    one is drawn, so the seen distance is that to the far ones in some seeds."""
    shapes, _ = wavy_cohort(8, subdivisions=2)
    aligned = align(shapes)[0]
    mean = aligned.vertices.mean(axis=0)
    away = [0.0, 50.0, 50.0, 50.0, 50.0, 50.0, 50.0, 50.0]
    meshes = [
        Mesh(mean + np.array([0, 0, z]), aligned.faces, case_id)
        for z, case_id in zip(away, aligned.case_ids, strict=True)
    ]
    settings = EvaluationSettings(points=100, surface_samples=4, screening_points=40)
    cohort = AlignedCohort(aligned, meshes)
    seen = [
        unseen_specificity(cohort, np.array([6, 7]), 2, settings, np.random.default_rng(seed))[
            "seen_surface_mm"
        ]
        for seed in range(12)
    ]
    # Two of six kept ones are drawn: the near one is among them in a third of the seeds.
    is_near = np.array(seen) < 15
    assert 0 < is_near.sum() < 9


def test_a_patients_cases_are_left_out_together() -> None:
    shapes, meshes = wavy_cohort(8, subdivisions=2)
    cohort = AlignedCohort(align(shapes)[0], meshes)
    settings = EvaluationSettings(points=100, jackknife_samples=6, screening_points=40)
    patients = ["a", "b", "c", "d", "d", "c", "b", "a"]
    table = without_each(cohort, 4, settings, np.random.default_rng(0), patients=patients)
    assert table["left_out"].tolist() == ["a", "a", "b", "b", "c", "c", "d", "d"]
    far = [
        type(mesh)(mesh.vertices + (1e4 if patient == "d" else 0), mesh.faces, mesh.case_id)
        for mesh, patient in zip(meshes, patients, strict=True)
    ]
    moved = without_each(
        AlignedCohort(cohort.shapes, far), 4, settings, np.random.default_rng(0), patients=patients
    )
    of_d = table["left_out"] == "d"  # neither of its meshes was looked at
    assert moved["surface_mm"][of_d].tolist() == table["surface_mm"][of_d].tolist()

import dataclasses

import igl
import numpy as np
import pytest
from synthetic_shapes import lattice, speckles, wavy_cohort

from ssm_pipeline.evaluation.aligned_cohort import AlignedCohort, align_cohort
from ssm_pipeline.evaluation.model_quality import (
    compactness,
    generalisation,
    held_out_folds,
    mean_over_cases,
)
from ssm_pipeline.evaluation.settings import EvaluationSettings, mode_counts
from ssm_pipeline.geometry.rigid import best_similarity
from ssm_pipeline.records import CorrespondedShapes, Mesh, StudyError
from ssm_pipeline.shape_model.alignment import align
from ssm_pipeline.shape_model.pca import pca_model


def residual_case() -> tuple[CorrespondedShapes, list[Mesh], np.ndarray]:
    """Four shapes that vary along u alone, and one that also has w, which is orthogonal to u.

    Both are symmetric stretches, so the best alignment leaves them as they are.
    """
    rest = speckles(lattice(4), "rest")
    points = rest.vertices
    u, w = points * [0, 0, 0.02], points * [0.03, -0.03, 0]
    shapes = np.stack([points + a * u for a in (-1, -0.5, 0.5, 1)] + [points + w])
    ids = tuple("abcde")
    corresponded = CorrespondedShapes(shapes, rest.faces, ids, "a")
    return corresponded, [Mesh(s, rest.faces, i) for s, i in zip(shapes, ids, strict=True)], w


def test_generalisation_of_a_case_outside_the_span_is_its_residual() -> None:
    shapes, meshes, w = residual_case()
    settings = EvaluationSettings(points=64)
    table = generalisation(AlignedCohort(shapes, meshes), settings, np.random.default_rng(0))
    held = table[table["case_id"] == "e"]
    residual = np.linalg.norm(w, axis=1).mean()
    assert held["correspondence_mm"].to_numpy() == pytest.approx(residual, rel=1e-9)
    # 1e-4 mm triangles instead of points, in float32.
    assert held["chamfer_mm"].to_numpy() == pytest.approx(residual, abs=1e-3)
    assert held["surface_mm"].to_numpy() == pytest.approx(residual, abs=1e-3)


def test_generalisation_of_scaled_copies_is_zero() -> None:
    # Every held-out shape lies in the one-mode span of the others, however far out.
    rest = speckles(lattice(4), "rest")
    shapes = np.stack([rest.vertices * scale for scale in (0.9, 0.95, 1.0, 1.02, 1.1)])
    ids = tuple("abcde")
    corresponded = CorrespondedShapes(shapes, rest.faces, ids, "a")
    meshes = [Mesh(s, rest.faces, i) for s, i in zip(shapes, ids, strict=True)]
    settings = EvaluationSettings(points=64)
    table = generalisation(AlignedCohort(corresponded, meshes), settings, np.random.default_rng(0))
    assert table["modes"].unique().tolist() == [1]
    assert table["correspondence_mm"].max() < 1e-9
    assert table["chamfer_mm"].max() < 1e-3


def test_leave_one_out_equals_a_loop_written_out() -> None:
    corresponded, meshes = wavy_cohort(6)
    cohort, _ = align_cohort(corresponded, meshes)
    table = generalisation(cohort, EvaluationSettings(), np.random.default_rng(0))
    assert len(table) == 6 * 4
    aligned, faces = cohort.shapes, cohort.shapes.faces
    for case in range(6):
        others = np.delete(aligned.vertices, case, axis=0)
        ids = tuple(np.delete(aligned.case_ids, case))
        others = align(CorrespondedShapes(others, faces, ids, aligned.template_id))[0].vertices
        mean = others.mean(axis=0)
        flat = (others - mean).reshape(5, -1)
        _, _, axes = np.linalg.svd(flat)
        shape = best_similarity(aligned.vertices[case], mean).apply(aligned.vertices[case])
        for modes in range(1, 5):
            basis = axes[:modes]
            rebuilt = mean + ((shape - mean).ravel() @ basis.T @ basis).reshape(mean.shape)
            row = table[(table["case_id"] == f"case_{case:02d}") & (table["modes"] == modes)]
            expected = np.linalg.norm(rebuilt - shape, axis=1).mean()
            assert row["correspondence_mm"].item() == pytest.approx(expected, rel=1e-6)
            there = np.sqrt(igl.point_mesh_squared_distance(rebuilt, shape, faces)[0])
            back = np.sqrt(igl.point_mesh_squared_distance(shape, rebuilt, faces)[0])
            expected = (there.mean() + back.mean()) / 2
            assert row["surface_mm"].item() == pytest.approx(expected, rel=1e-6)
            hd95 = max(np.percentile(there, 95), np.percentile(back, 95))
            assert row["hd95_mm"].item() == pytest.approx(hd95, rel=1e-6)


def test_generalisation_does_not_depend_on_pose() -> None:
    corresponded, meshes = wavy_cohort(5)
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    turned = dataclasses.replace(corresponded, vertices=corresponded.vertices @ turn.T + 500)
    turned_meshes = [dataclasses.replace(m, vertices=m.vertices @ turn.T + 500) for m in meshes]
    tables = []
    for shapes, surfaces in ((corresponded, meshes), (turned, turned_meshes)):
        cohort, _ = align_cohort(shapes, surfaces)
        tables.append(generalisation(cohort, EvaluationSettings(), np.random.default_rng(0)))
    for column in ("surface_mm", "hd95_mm", "correspondence_mm"):
        assert tables[0][column].to_numpy() == pytest.approx(tables[1][column].to_numpy(), rel=1e-5)


def test_folds_hold_out_every_case_once() -> None:
    corresponded, meshes = wavy_cohort(7)
    cohort, _ = align_cohort(corresponded, meshes)
    settings, folds = EvaluationSettings(points=200), held_out_folds(7, 3, seed=5)
    assert sorted(np.concatenate(folds)) == list(range(7))
    table = generalisation(cohort, settings, np.random.default_rng(0), folds=folds)
    for modes in (1, 2, 3):  # 4 or 5 cases remain, and all are scored alike
        assert table[table["modes"] == modes]["case_id"].tolist() == list(corresponded.case_ids)
    assert table["modes"].max() == 3


def test_a_held_out_fold_is_unknown_to_its_model() -> None:
    """Whatever else is in the fold: its cases are scored as if it alone had been left out."""
    corresponded, meshes = wavy_cohort(7)
    cohort, _ = align_cohort(corresponded, meshes)
    settings, folds = EvaluationSettings(points=200), [np.array([5, 6]), np.arange(5)[:2]]
    rest = [np.array([case]) for case in (2, 3, 4)]
    before = generalisation(cohort, settings, np.random.default_rng(0), folds=folds + rest)
    vertices = cohort.shapes.vertices.copy()
    vertices[5] *= [1, 1, 3]  # a monster, held out together with case 6
    monster = dataclasses.replace(cohort.shapes, vertices=vertices)
    changed = dataclasses.replace(cohort, shapes=monster)
    after = generalisation(changed, settings, np.random.default_rng(0), folds=folds + rest)
    column = "correspondence_mm"
    for case_id, is_same in (("case_06", True), ("case_00", False)):
        old, new = (t[t["case_id"] == case_id][column].to_numpy() for t in (before, after))
        assert np.allclose(old, new, rtol=1e-9) == is_same, case_id


def test_folds_are_the_same_for_every_method() -> None:
    first, again = held_out_folds(22, 5, seed=3), held_out_folds(22, 5, seed=3)
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert sorted(map(len, first)) == [4, 4, 4, 5, 5]


def test_of_hundreds_of_cases_a_hundred_folds_are_held_out() -> None:
    folds = held_out_folds(250, 0, seed=3)
    assert len(folds) == 100
    assert sorted(np.concatenate(folds)) == list(range(250))
    assert len(held_out_folds(100, 0, seed=3)) == 100
    patients = [str(case // 2) for case in range(250)]  # two cases each
    for fold in held_out_folds(250, 0, seed=3, patients=patients):
        assert {patients[case] for case in fold} <= {patients[case] for case in fold if case % 2}


def test_mean_over_cases() -> None:
    corresponded, meshes = wavy_cohort(5)
    cohort, _ = align_cohort(corresponded, meshes)
    cases = generalisation(cohort, EvaluationSettings(), np.random.default_rng(0))
    summary = mean_over_cases(cases)
    values = cases[cases["modes"] == 2]["surface_mm"].to_numpy()
    row = summary[summary["modes"] == 2]
    assert row["surface_mm"].item() == pytest.approx(values.mean())
    assert row["surface_se_mm"].item() == pytest.approx(values.std(ddof=1) / np.sqrt(5))
    assert row["samples"].item() == 5


def test_compactness_reaches_one() -> None:
    corresponded, _ = wavy_cohort(6)
    table = compactness(pca_model(align(corresponded)[0]))
    assert table["share"].is_monotonic_increasing
    assert table["share"].iloc[-1] == pytest.approx(1)


def test_mode_counts() -> None:
    assert mode_counts(5, 24) == [1, 2, 3, 4, 5]
    spread = mode_counts(100, 24)
    assert len(spread) == 24
    assert spread[0] == 1
    assert spread[-1] == 100
    assert mode_counts(9, 1) == [1]


def test_clear_errors() -> None:
    corresponded, meshes = wavy_cohort(5)
    with pytest.raises(StudyError, match="case_04"):
        align_cohort(corresponded, meshes[:4])
    few = AlignedCohort(*wavy_cohort(3))
    with pytest.raises(StudyError, match="at least 4 cases"):
        generalisation(few, EvaluationSettings(), np.random.default_rng(0))
    with pytest.raises(StudyError, match="folds is 9"):
        held_out_folds(5, 9, seed=0)
    with pytest.raises(StudyError, match="2 remain"):
        held_out_folds(4, 2, seed=0)


def test_a_patients_cases_are_held_out_together() -> None:
    patients = [f"p{case // 2}" for case in range(20)]
    folds = held_out_folds(20, 3, seed=1, patients=patients)
    assert sorted(np.concatenate(folds)) == list(range(20))
    for fold in folds:
        of_fold = {patients[case] for case in fold}
        assert len(fold) == 2 * len(of_fold)
    assert [fold.tolist() for fold in held_out_folds(5, 0, 0, [*"abbcc"])] == [
        [0],
        [1, 2],
        [3, 4],
    ]
    plain, own = held_out_folds(9, 3, 2), held_out_folds(9, 3, 2, [str(i) for i in range(9)])
    assert all((one == other).all() for one, other in zip(plain, own, strict=True))
    with pytest.raises(StudyError, match=r"folds is 4 for 2 patients; 0 .* 2 … 2"):
        held_out_folds(8, 4, 0, [*"aaaabbbb"])
    with pytest.raises(StudyError, match="1 remain when a fold is left out"):
        held_out_folds(4, 0, 0, ["a", "a", "a", "b"])


def test_no_mean_is_over_fewer_cases_than_its_neighbours() -> None:
    """A model with both copies of a case has a mode less than one without them."""
    shapes, meshes = wavy_cohort(5)
    vertices = np.concatenate([shapes.vertices, shapes.vertices[:1]])
    ids = (*shapes.case_ids, "copy")
    both = CorrespondedShapes(vertices, shapes.faces, ids, ids[0])
    cohort, _ = align_cohort(both, [*meshes, Mesh(vertices[0], shapes.faces, "copy")])
    settings, errors = EvaluationSettings(points=100), {}
    for patients in ("abcdea", "abcdef"):
        folds = held_out_folds(6, 0, 0, [*patients])
        table = generalisation(cohort, settings, np.random.default_rng(0), folds)
        assert mean_over_cases(table)["samples"].tolist() == [6, 6, 6]
        of_case = table[(table["modes"] == 3) & (table["case_id"] == "case_00")]
        errors[patients] = of_case["correspondence_mm"].item()
    # A model that holds its copy explains a case for nothing.
    assert errors["abcdef"] < 0.5 * errors["abcdea"]

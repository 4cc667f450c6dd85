"""Labels of parts and landmarks per case, from masks and files to the tables of all methods."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tiny_study import tiny_settings

from ssm_pipeline import load_run, storage
from ssm_pipeline.commands.run_study import run_study
from ssm_pipeline.comparison.anatomy import evaluation_depends_on, landmarks_of_cases
from ssm_pipeline.data_prep.synthetic.phantoms import draw_truth
from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.evaluation.settings import EvaluationSettings
from ssm_pipeline.records import Mesh, StudyError, SurfaceLabels
from ssm_pipeline.stages.list import STAGES
from ssm_pipeline.study.settings import StudySettings
from ssm_pipeline.study.sources import PhantomData

TUBES = PhantomData(family="tube", cases=4, seed=1)
MARKED = [50, 900, 2500]  # points of the truth's reference


def write_markups(folder: Path, case_id: str, names: list[str], points: np.ndarray) -> None:
    folder.mkdir(exist_ok=True)
    rows = [{"label": n, "position": list(p)} for n, p in zip(names, points, strict=True)]
    markup = {"type": "Fiducial", "coordinateSystem": "LPS", "controlPoints": rows}
    (folder / f"{case_id}.mrk.json").write_text(json.dumps({"markups": [markup]}))


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> StudySettings:
    folder = tmp_path_factory.mktemp("landmarks")
    truth = draw_truth(TUBES)
    for case_id, points in zip(truth.case_ids, truth.vertices, strict=True):
        write_markups(folder, case_id, ["a", "b", "c"], points[MARKED])
    tiny = tiny_settings(folder, steps=1)
    evaluation = tiny.evaluation.model_copy(update={"landmarks": folder, "points": 2000})
    comparison = tiny.comparison.model_copy(update={"methods": ("nearest point",)})
    meshing = tiny.meshing.model_copy(update={"faces": 1500})
    changes = {"data": TUBES, "meshing": meshing}
    return tiny.model_copy(update=changes | {"evaluation": evaluation, "comparison": comparison})


@pytest.fixture(scope="module")
def folder(settings: StudySettings, tmp_path_factory: pytest.TempPathFactory) -> Path:
    options = RunOptions(tmp_path_factory.mktemp("runs"))
    return run_study("tubes", settings, options, Terminal(), STAGES[:-1])


def test_every_mesh_keeps_the_labels_of_its_mask(folder: Path) -> None:
    run = load_run(folder)
    for case_id in run.cases:
        labels = storage.load(SurfaceLabels, folder / "meshing" / case_id / "labels.npz")
        assert labels.values.tolist() == [1, 2]
        assert labels.shares.shape == (len(run.mesh(case_id).vertices), 2)
        # The head is before the border and y grows backwards.
        y = run.mesh(case_id).vertices[:, 1]
        assert y[labels.labels == 1].max() < y[labels.labels == 2].mean()


def test_labels_of_every_method_with_intervals(folder: Path) -> None:
    tables = load_run(folder).metrics.tables
    methods = {"full", "nearest point", "true correspondence"}
    assert set(tables["labels"]["method"]) == methods
    assert tables["labels"].groupby("method").size().eq(4).all()
    assert "label_pairs" not in tables  # in the methods' own folders
    means = tables["labels_mean"].set_index("method")
    pairs = storage.read_table(folder / "evaluation" / "full" / "scores" / "label_pairs.csv")
    assert len(pairs) == 12
    assert means.loc["full", "border_mm"] == pytest.approx(pairs["border_mm"].mean())
    assert means.loc["full", "border_difference_mm"] == 0
    # Known matches: what is left is 1 mm voxels and the mesh, not anatomy.
    assert means.loc["true correspondence", "border_mm"] < 0.5
    assert means.loc["nearest point", "border_mm"] > means.loc["true correspondence", "border_mm"]
    assert (means["border_low_mm"] <= means["border_mm"]).all()
    assert (means["border_high_mm"] >= means["border_mm"]).all()


def test_landmarks_of_every_method(folder: Path) -> None:
    tables = load_run(folder).metrics.tables
    assert len(tables["landmarks"]) == 3 * 4 * 3  # methods, cases, landmarks
    assert set(tables["landmarks"]["landmark"]) == {"a", "b", "c"}
    means = tables["landmarks_mean"].set_index("method")
    # True points lie within half a voxel of the mesh, whose triangles are coarse.
    assert means.loc["true correspondence", "error_mm"] < 0.5
    assert means.loc["nearest point", "error_mm"] > means.loc["true correspondence", "error_mm"]
    assert means.loc["full", "cases"] == 4


def test_what_landmark_files_hold_is_part_of_the_key(settings: StudySettings) -> None:
    before = evaluation_depends_on(settings)
    folder = settings.evaluation.landmarks
    assert folder is not None
    path = folder / "phantom.000.mrk.json"
    content = path.read_text()
    path.write_text(content.replace('"a"', '"A"'))
    assert evaluation_depends_on(settings) != before
    path.write_text(content)
    assert evaluation_depends_on(settings) == before


def surfaces() -> list[Mesh]:
    corners = np.array([[0.0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 10]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    return [Mesh(corners, faces, case_id) for case_id in ("one", "two", "three")]


def test_landmarks_are_read_in_the_order_of_their_names(tmp_path: Path) -> None:
    write_markups(tmp_path, "one", ["x", "y"], np.array([[1.0, 0, 0], [0, 2, 0]]))
    write_markups(tmp_path, "three", ["y", "x"], np.array([[0.0, 3, 0], [4, 0, 0]]))
    names, positions = landmarks_of_cases(tmp_path, surfaces())
    assert names == ("x", "y")
    assert set(positions) == {"one", "three"}
    np.testing.assert_array_equal(positions["three"], [[4, 0, 0], [0, 3, 0]])


def test_fcsv_files_are_read_and_are_part_of_the_key(tmp_path: Path) -> None:
    header = (
        "# CoordinateSystem = RAS\n# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,a\n"
    )
    for case_id, x in (("one", -1), ("two", -2)):
        path = tmp_path / f"{case_id}.fcsv"
        path.write_text(f"{header}1,{x},0,0,0,0,0,1,1,1,0,tip,,\n")
    names, positions = landmarks_of_cases(tmp_path, surfaces())
    assert (names, set(positions)) == (("tip",), {"one", "two"})
    np.testing.assert_array_equal(positions["two"], [[2, 0, 0]])
    changed = {"evaluation": EvaluationSettings(landmarks=tmp_path)}
    settings = StudySettings(data=TUBES).model_copy(update=changed)
    assert set(evaluation_depends_on(settings)["landmarks"]) == {"one.fcsv", "two.fcsv"}
    write_markups(tmp_path, "two", ["tip"], np.array([[2.0, 0, 0]]))
    with pytest.raises(StudyError, match=r"holds two\.mrk\.json and two\.fcsv; one file per case"):
        landmarks_of_cases(tmp_path, surfaces())


def test_landmarks_that_cannot_be_compared_are_refused(tmp_path: Path) -> None:
    on = np.array([[1.0, 0, 0]])
    write_markups(tmp_path, "one", ["x"], on)
    with pytest.raises(StudyError, match=r"landmarks of 1 of the 3 cases.*one\.mrk\.json"):
        landmarks_of_cases(tmp_path, surfaces())
    write_markups(tmp_path, "two", ["z"], on)
    with pytest.raises(StudyError, match=r"two\.mrk\.json holds the landmarks z; .* are x"):
        landmarks_of_cases(tmp_path, surfaces())
    write_markups(tmp_path, "two", ["x"], on - [0, 0, 50])
    with pytest.raises(StudyError, match=r"landmark x of .*two\.mrk\.json lies 50\.0 mm"):
        landmarks_of_cases(tmp_path, surfaces())


def test_case_ids_of_digits_stay_text(tmp_path: Path) -> None:
    table = pd.DataFrame({"from_case_id": ["007"], "case_id": ["010"], "landmark": ["1"]})
    table.to_csv(tmp_path / "pairs.csv", index=False)
    pd.testing.assert_frame_equal(storage.read_table(tmp_path / "pairs.csv"), table)


def test_landmarks_of_mirrored_cases_are_mirrored(tmp_path: Path) -> None:
    """The mesh of a right case is the mirror image of its scan, on which the landmarks lie."""
    corners = np.array([[0.0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 10]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    left = Mesh(corners, faces, "p_left")
    right = Mesh(corners * [-1, 1, 1], faces[:, ::-1], "p_right")  # as the stage meshing leaves it
    on_scan = np.array([[1.0, 0, 0], [0, 2, 0]])
    for mesh in (left, right):
        write_markups(tmp_path, mesh.case_id, ["a", "b"], on_scan)
    _, positions = landmarks_of_cases(tmp_path, [left, right], mirrored="right")
    np.testing.assert_array_equal(positions["p_left"], on_scan)
    np.testing.assert_array_equal(positions["p_right"], on_scan * [-1, 1, 1])

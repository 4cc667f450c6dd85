"""`report.landmarks`: on the page at every case, the file part of the report's key, checked."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import Said, Workflow
from tiny_study import tiny_settings

from ssm_pipeline import load_run
from ssm_pipeline.commands.run_study import run_study
from ssm_pipeline.data_prep.formats.landmarks import read_landmarks
from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.records import StudyError
from ssm_pipeline.runs.run import Run


@pytest.fixture(scope="module")
def run_copy(tiny_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    copy = tmp_path_factory.mktemp("landmarks") / "runs" / tiny_run.name
    shutil.copytree(tiny_run, copy)
    return copy


def write_markups(path: Path, points_lps: np.ndarray) -> Path:
    """As 3D Slicer before 5 saved them: in RAS."""
    rows = [
        {"label": f"mark {index}", "position": list(point * (-1.0, -1.0, 1.0))}
        for index, point in enumerate(points_lps)
    ]
    content = {"markups": [{"type": "Fiducial", "coordinateSystem": "RAS", "controlPoints": rows}]}
    path.write_text(json.dumps(content))
    return path


def on_template(run: Run, vertices: list[int]) -> np.ndarray:
    points: np.ndarray = run.shapes.vertices[run.cases.index(run.template_id)][vertices]
    return points


def description(run_folder: Path) -> dict[str, Any]:
    page = (run_folder / "report" / "index.html").read_text(encoding="utf-8")
    found = re.search(r'<script [^>]*id="description">(.*?)</script>', page, flags=re.DOTALL)
    assert found
    content: dict[str, Any] = json.loads(found[1])
    return content


def renew(workflow: Workflow, run_folder: Path, file: Path) -> Said:
    words = ("--set", f"report.landmarks={file}", "--jobs", "1")
    return workflow("evaluate", str(run_folder), *words)


def test_landmarks_are_shown_on_every_case_and_renewed_with_their_file(
    workflow: Workflow, run_copy: Path, tmp_path: Path
) -> None:
    run, vertices = load_run(run_copy), [3, 40]
    file = write_markups(tmp_path / "marks.mrk.json", on_template(run, vertices))
    said = renew(workflow, run_copy, file)
    assert said.code == 0, said.stderr
    shown = description(run_copy)
    assert shown["landmarks"] == ["mark 0", "mark 1"]
    for case in shown["cases"]:
        own = run.aligned.vertices[run.cases.index(case["id"])][vertices]
        np.testing.assert_allclose(case["landmarks"], own, atol=1e-6)  # a vertex stays a vertex

    assert "nothing to do" in renew(workflow, run_copy, file).stdout
    stamps = {path: path.stat().st_mtime_ns for path in run_copy.glob("*/stage.json")}
    write_markups(file, on_template(run, [3, 40, 41]))  # the same name, another content
    assert renew(workflow, run_copy, file).code == 0
    assert len(description(run_copy)["landmarks"]) == 3
    renewed = {p.parent.name for p, stamp in stamps.items() if p.stat().st_mtime_ns != stamp}
    assert renewed == {"report"}


def test_landmarks_of_another_place_are_refused(
    workflow: Workflow, run_copy: Path, tmp_path: Path
) -> None:
    points = on_template(load_run(run_copy), [3, 40])
    points[1] += 200
    said = renew(workflow, run_copy, write_markups(tmp_path / "far.mrk.json", points))
    assert said.code == 1
    assert re.search(r"landmark mark 1 of .*far\.mrk\.json lies \d+\.\d mm from", said.stderr)
    assert "Place it on meshes/template.ply" in said.stderr


def test_a_missing_file_says_so_before_any_work(tmp_path: Path) -> None:
    settings = tiny_settings(tmp_path / "masks")
    changed = settings.report.model_copy(update={"landmarks": tmp_path / "none.mrk.json"})
    settings = settings.model_copy(update={"report": changed})
    with pytest.raises(StudyError, match=r"none\.mrk\.json can't be read \(No such file"):
        run_study("toy", settings, RunOptions(tmp_path / "runs"), Terminal())
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    "text",
    [
        "not JSON",
        "[1, 2]",
        '{"markups": []}',
        '{"markups": [{"controlPoints": [{"label": "a"}]}]}',
        '{"markups": [{"controlPoints": [{"label": "a", "position": [1, "b", 2]}]}]}',
        '{"markups": [{"controlPoints": [{"label": "a", "position": [1, 2]}]}]}',
        '{"markups": null}',
    ],
)
def test_a_file_without_markups_is_refused(text: str, tmp_path: Path) -> None:
    file = tmp_path / "marks.mrk.json"
    file.write_text(text)
    with pytest.raises(StudyError, match=r"marks\.mrk\.json holds no markups: .* Save it from"):
        read_landmarks(file)

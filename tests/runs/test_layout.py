"""Files of a run: one place each, read by whoever may read them."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from ssm_pipeline.records import StudyError
from ssm_pipeline.runs import layout
from ssm_pipeline.runs.layout import MATCHER, MESH, PATH, SHAPES, CaseFile, RunFiles, StageFile
from ssm_pipeline.runs.run import Run
from ssm_pipeline.stages.list import STAGES

FILES = [file for file in vars(layout).values() if isinstance(file, CaseFile | StageFile)]


def test_every_file_of_the_layout_lies_where_the_run_wrote_it(tiny_run: Path) -> None:
    run = Run(tiny_run)
    for file in FILES:
        if file.name == "labels.npz":  # of masks with several parts
            continue
        of_cases = run.path_cases if file is PATH else run.cases
        for case_id in of_cases if isinstance(file, CaseFile) else (None,):
            run.load(file, case_id)


def test_each_file_is_of_a_stage_in_the_list() -> None:
    assert len(FILES) > 15
    assert {file.stage for file in FILES} <= {stage.name for stage in STAGES}


def test_a_stage_may_not_read_what_its_key_does_not_depend_on(tiny_run: Path) -> None:
    files = RunFiles(tiny_run, frozenset({"meshing"}))
    files.load(MESH, "ball_0")
    with pytest.raises(LookupError, match="Add groupwise to `needs`"):
        files.load(SHAPES)
    with pytest.raises(LookupError, match="training"):
        files.where(MATCHER)
    with pytest.raises(LookupError, match="evaluation"):
        _ = Run(tiny_run, frozenset({"meshing"})).metrics


def test_a_file_of_an_unfinished_stage_or_of_no_case_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match="the stage groupwise is not finished"):
        RunFiles(tmp_path).load(SHAPES)
    (tmp_path / "meshing").mkdir()
    (tmp_path / "meshing" / "stage.json").write_text("{}")
    with pytest.raises(StudyError, match=re.escape("has no meshing/a/mesh.npz")):
        RunFiles(tmp_path).load(MESH, "a")


def test_a_run_reads_by_the_same_definitions(tiny_run: Path) -> None:
    run, files = Run(tiny_run), RunFiles(tiny_run)
    np.testing.assert_array_equal(run.shapes.vertices, files.load(SHAPES).vertices)

"""`ssm_pipeline.run`: what `workflow run` does, as a function."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import pytest
from shapes import blob

import ssm_pipeline
from ssm_pipeline.records import StudyError


def test_a_finished_study_is_read_back_and_nothing_is_done_again(
    tiny_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study = tmp_path / f"{tiny_run.name}.yaml"
    shutil.copy(tiny_run / "study.yaml", study)
    settings = {"adaptation.samples": 500, "data.labels": [3]}  # what it has already
    run = ssm_pipeline.run(study, settings=settings, runs=tiny_run.parent, jobs=1)
    assert "nothing to do" in capsys.readouterr().out
    assert run.folder == tiny_run
    assert run.model.mode_count == 3


def test_a_setting_that_does_not_exist_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=r"training\.stepz\. Did you mean steps"):
        ssm_pipeline.run("luna16", settings={"training.stepz": 3}, runs=tmp_path)
    assert not list(tmp_path.iterdir())


def test_two_meshes_with_one_id_are_refused_before_any_work() -> None:
    meshes = [blob(seed, faces=200) for seed in range(3)]
    alike = [ssm_pipeline.Mesh(mesh.vertices, mesh.faces, "liver") for mesh in meshes]
    with pytest.raises(StudyError, match=r"3 cases have the id liver.*case_id="):
        ssm_pipeline.match_cohort(alike, None, method="adaptation only")


def test_a_method_that_does_not_exist_is_refused() -> None:
    meshes = [dataclasses.replace(blob(seed, faces=200), case_id=f"b{seed}") for seed in range(3)]
    for method in ("nricp", "Full", "S3M"):
        with pytest.raises(StudyError, match=rf"no method '{method}': full, network start"):
            ssm_pipeline.match_cohort(meshes, None, template="b0", method=method)

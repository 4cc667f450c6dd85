"""`workflow evaluate`, `figures` and `view`: what can be done with a finished run."""

from __future__ import annotations

import dataclasses
import shutil
import webbrowser
from pathlib import Path

import pandas as pd
import pytest
import torch
from command_line import Workflow

from ssm_pipeline import load_run, storage
from ssm_pipeline.baselines.s3m import epochs
from ssm_pipeline.evaluation.model_quality import held_out_folds
from ssm_pipeline.export.comparison_files import ABOUT_FILE
from ssm_pipeline.records import CorrespondedShapes, Metrics
from ssm_pipeline.runs.former_results import former_results
from ssm_pipeline.training import train


@pytest.fixture
def run_copy(tiny_run: Path, tmp_path: Path) -> Path:
    copy = tmp_path / "runs" / tiny_run.name
    shutil.copytree(tiny_run, copy)
    return copy


def test_figures_and_comparisons_of_a_former_model_are_named(
    workflow: Workflow, run_copy: Path
) -> None:
    assert workflow("figures", "luna16").code == 0
    key = load_run(run_copy).model_key
    about = run_copy / "compare" / "age" / ABOUT_FILE
    storage.write_json(about, {"model_key": key, "formula": "~ age"})
    for command in ("status", "verify"):
        assert "former model" not in workflow(command, str(run_copy)).stdout
    model = load_run(run_copy).model
    dataclasses.replace(model, mean=model.mean + 1).save(run_copy / "shape_model" / "model.npz")
    lines = former_results(run_copy)
    assert len(lines) == 2
    assert "figures shows a former model" in lines[0]
    assert "workflow figures luna16" in lines[0]
    assert str(about.parent) in lines[1]
    assert '"~ age"' in lines[1]
    said = workflow("status", str(run_copy)).stdout
    assert all(line in said for line in lines)
    assert workflow("figures", "luna16").code == 0
    assert len(former_results(run_copy)) == 1


def test_evaluate_scores_again_and_only_that(workflow: Workflow, run_copy: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in run_copy.glob("*/stage.json")}
    said = workflow("evaluate", str(run_copy), "--samples", "25", "--jobs", "1")
    assert said.code == 0, said.stderr
    assert f"report: {run_copy / 'report' / 'index.html'}" in said.stdout
    renewed = {p.parent.name for p, stamp in before.items() if p.stat().st_mtime_ns != stamp}
    assert renewed == {"evaluation", "report"}
    tables = load_run(run_copy).metrics.tables
    assert set(tables["specificity"]["samples"]) == {25}
    assert set(tables["comparison_95"]["method"]) == {"full", "adaptation only", "S3M"}
    assert "unseen_generalisation" not in tables
    saw_case = tables["generalisation"].groupby("method")["matching_saw_case"].all()
    assert saw_case.to_dict() == {"full": True, "adaptation only": False, "S3M": True}


def test_retrained_folds_never_see_the_cases_they_are_asked_about(
    workflow: Workflow, run_copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ("evaluate", str(run_copy), "--folds", "4", "--retrain", "--jobs", "1")
    said = workflow(*words)
    assert said.code == 0, said.stderr
    run = load_run(run_copy)
    cases, folds = run.cases, held_out_folds(4, 4, run.settings["seed"])
    for number, held_out in enumerate(folds, start=1):
        folder = run_copy / "evaluation" / "retrained-folds" / f"fold-{number}"
        (matcher,) = folder.glob("matcher-*.pt")
        seen = torch.load(matcher, weights_only=True)["trained_on"]
        assert set(seen) == set(cases) - {cases[held_out[0]]}
        template_id = storage.read_json(next(folder.glob("*.template.json")))["template_id"]
        assert template_id in seen
        s3m = storage.load(CorrespondedShapes, folder / "S3M" / "shapes" / "points.npz")
        assert s3m.template_id in seen
        for method in ("full", "S3M"):
            tables = storage.load_tables(folder / "scores" / method).tables
            assert set(tables["unseen_generalisation"]["case_id"]) == {cases[held_out[0]]}
    tables = run.metrics.tables
    unseen = tables["unseen_generalisation"]
    assert set(unseen["method"]) == {"full", "S3M"}  # adaptation only learns of no other case
    assert not unseen.isna().any(axis=None)
    assert len(tables["unseen_specificity"]) == 8
    rows = tables["comparison"].set_index("method")
    expected = unseen.query("method == 'full' and modes == 2")["surface_mm"].mean()
    column = "unseen_generalisation_surface"
    assert rows.loc["full", f"{column}_mm"] == pytest.approx(expected)
    without_network = rows.loc["adaptation only"]
    assert without_network[f"{column}_mm"] == without_network["generalisation_surface_mm"]
    difference = rows.loc["S3M", f"{column}_difference_mm"]
    assert rows.loc["S3M", f"{column}_low_mm"] <= difference <= rows.loc["S3M", f"{column}_high_mm"]
    assert rows["unseen_specificity_surface_mm"].notna().tolist() == [True, False, True]

    # What is finished is kept: the same folds after another change train nothing.
    monkeypatch.setattr(train, "pair_loss", lambda *a: pytest.fail("trained again"))
    monkeypatch.setattr(epochs, "batch_loss", lambda *a: pytest.fail("trained again"))
    assert workflow(*words, "--samples", "21").code == 0
    # And without --retrain its tables are gone.
    back = workflow("evaluate", str(run_copy), "--set", "comparison.retrain=false")
    assert back.code == 0
    tables = load_run(run_copy).metrics.tables
    assert "unseen_generalisation" not in tables
    assert f"{column}_mm" not in tables["comparison"]


def test_impossible_folds_are_refused(workflow: Workflow, run_copy: Path) -> None:
    settings = (run_copy / "study.yaml").read_text()
    said = workflow("evaluate", str(run_copy), "--retrain")
    assert said.code == 1
    assert "needs evaluation.folds of 2 or more; it is 0. Pass --folds 5" in said.stderr
    assert (run_copy / "study.yaml").read_text() == settings
    said = workflow("evaluate", str(run_copy), "--folds", "2")
    assert said.code == 1
    assert "each must leave 3 cases" in said.stderr


def test_evaluate_wants_a_run(workflow: Workflow, tmp_path: Path) -> None:
    said = workflow("evaluate", str(tmp_path / "nowhere"))
    assert said.code == 1
    assert "holds no run; give a folder such as runs/luna16" in said.stderr


def test_figures_in_the_formats_asked_for(workflow: Workflow, run_copy: Path) -> None:
    changes = ("--set", "dpi=60", "--set", "modes=1")
    said = workflow(
        "figures", "luna16", "--runs", str(run_copy.parent), "--format", "png", *changes
    )
    assert said.code == 0, said.stderr
    written = [Path(line) for line in said.stdout.split()]
    assert {path.suffix for path in written} == {".png"}
    assert len(written) >= 4
    assert all(path.parent == run_copy / "figures" for path in written)
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in written)
    wrong = workflow("figures", "luna16", "--runs", str(run_copy.parent), "--set", "dpis=60")
    assert wrong.code == 1
    assert "there is no setting dpis. Did you mean dpi?" in wrong.stderr


def test_view_opens_the_page(
    workflow: Workflow, run_copy: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    said = workflow("view", "luna16")
    assert said.code == 0, said.stderr
    assert opened == [(tmp_path / "runs/luna16/report/index.html").as_uri()]
    missing = workflow("view", "hippocampus")
    assert missing.code == 1
    assert "make it with: workflow run hippocampus" in missing.stderr
    assert len(opened) == 1


def test_case_ids_that_look_like_numbers_stay_text(tmp_path: Path) -> None:
    storage.save_tables(
        Metrics({"fit": pd.DataFrame({"case_id": ["007"], "x_mm": [1.0]})}), tmp_path
    )
    table = storage.load_tables(tmp_path).tables["fit"]
    assert table.loc[0, "case_id"] == "007"
    assert table.loc[0, "x_mm"] == 1.0

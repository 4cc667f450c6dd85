"""`verify`, `status`, `doctor` and `forget` on a real run, and how the command line ends."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from command_line import Workflow
from tiny_study import NAME, run_tiny, tiny_settings, without_comparison, write_balls

from ssm_pipeline.commands.forget_case import forget_case
from ssm_pipeline.commands.run_status import work_in_hand
from ssm_pipeline.commands.run_study import run_study
from ssm_pipeline.engine.ownership import alone_in
from ssm_pipeline.engine.run_log import RunLog, read_events
from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.records import StudyError
from ssm_pipeline.study.study import read_run_settings


@pytest.fixture
def copy(tiny_run: Path, tmp_path: Path) -> Path:
    folder = tmp_path / "runs" / NAME
    shutil.copytree(tiny_run, folder)
    return folder


def test_verify_finds_a_changed_byte_and_the_next_run_mends_it(
    workflow: Workflow, tiny_run: Path, copy: Path
) -> None:
    assert workflow("verify", str(copy)).code == 0
    mesh = copy / "meshing" / "ball_0" / "mesh.npz"
    whole = mesh.read_bytes()
    mesh.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    found = workflow("verify", str(copy))
    assert found.code == 1
    assert "ball_0/mesh.npz has changed since it was written" in found.stdout
    assert mesh.exists()
    assert workflow("verify", str(copy), "--remove").code == 1
    assert not mesh.exists()
    run_tiny(tiny_run.parent.parent / "masks", copy.parent)
    assert mesh.read_bytes() == whole
    assert workflow("verify", str(copy)).code == 0


def test_verify_of_no_run_says_so(workflow: Workflow, tmp_path: Path) -> None:
    said = workflow("verify", str(tmp_path))
    assert said.code == 1
    assert "holds no run" in said.stderr


def test_status_of_a_finished_run_has_a_line_a_stage(workflow: Workflow, tiny_run: Path) -> None:
    said = workflow("status", str(tiny_run)).stdout.splitlines()
    assert [line.split()[0] for line in said[1:11]] == [
        "data", "meshing", "cohort_check", "spectral", "training", "correspondence", "groupwise",
        "shape_model", "evaluation", "report",
    ]  # fmt: skip
    assert said[-1] == "finished"


def test_status_of_work_in_hand_gives_its_pace(workflow: Workflow, tmp_path: Path) -> None:
    events = [
        event(0, "run"),
        event(0, "stage started", stage="meshing", cases=10),
        event(4, "case", stage="meshing", case_id="a", dropped="too small"),
        event(20, "progress", label="meshing", done=4, total=10),
    ]
    folder = with_log(tmp_path / "runs" / "x", events, '{"half')
    work = work_in_hand(list(read_events(folder)))
    assert work is not None
    assert (work.stage, work.done, work.total, work.dropped) == ("meshing", 4, 10, 1)
    assert work.seconds_left == pytest.approx(30)  # 4 took 20 s, 6 are left
    stopped = workflow("status", str(folder)).stdout
    assert "stopped: meshing 4 of 10, 1 dropped, about 30 s to go" in stopped
    assert "in all: unknown; the log does not list the stages after meshing" in stopped
    with alone_in(folder):
        assert "now: meshing 4 of 10" in workflow("status", str(folder)).stdout
    with_log(folder, [*events, event(30, "stage finished", stage="meshing")])
    # The log names a finished stage, and its record is gone.
    assert (
        workflow("status", str(folder)).stdout.splitlines()[-1].startswith("no stage is finished")
    )


def event(second: int, kind: str, **what: object) -> dict[str, object]:
    when = f"2026-01-01T00:{second // 60:02d}:{second % 60:02d}+00:00"
    return {"time": when, "event": kind, **what}


def with_log(folder: Path, events: list[dict[str, object]], rest: str = "") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "run.jsonl").write_text("".join(json.dumps(e) + "\n" for e in events) + rest)
    return folder


def planned(second: int, steps: int) -> dict[str, object]:
    """The run's own event: meshing, training with so many steps, report."""
    likes = {"meshing": "m", "training": f"t{steps}", "report": "r"}
    stages = [
        {"stage": stage, "like": like, "per_case": stage != "training"}
        for stage, like in likes.items()
    ]
    return event(second, "run", stages=stages)


def test_status_foresees_the_stages_to_come_by_what_they_took_before(
    workflow: Workflow, tmp_path: Path
) -> None:
    """Another run beside it had 10 cases: 20 s of meshing, stopped half-way; 100 s of training."""
    with_log(
        tmp_path / "runs" / "before",
        [
            planned(0, steps=500),
            event(0, "stage started", stage="meshing", cases=10),
            *(event(n, "case", stage="meshing", case_id=str(n), dropped=None) for n in range(1, 6)),
            event(10, "run stopped", error="KeyboardInterrupt"),
            planned(300, steps=500),
            event(300, "stage started", stage="meshing", cases=10),
            *(event(300 + n, "case", stage="meshing", case_id=str(n), dropped=None)
              for n in range(6, 11)),
            event(310, "stage finished", stage="meshing"),
            event(310, "stage started", stage="training", cases=10),
            event(410, "stage finished", stage="training"),
            event(410, "stage started", stage="report", cases=10),
            event(415, "stage finished", stage="report"),
            event(415, "run finished"),
        ],
    )  # fmt: skip
    meshing = [
        event(0, "stage started", stage="meshing", cases=30),
        event(30, "progress", label="meshing", done=15, total=30),
    ]
    runs = tmp_path / "runs"
    same = workflow("status", str(with_log(runs / "a", [planned(0, steps=500), *meshing]))).stdout
    # 30 cases are three times as many: 60 s of meshing, 15 s of report; training stays 100 s.
    assert "stopped: meshing 15 of 30, about 30 s to go" in same
    assert "then: training 1 min 40 s, report 15 s, estimated from earlier runs" in same
    assert same.splitlines()[-1] == "in all: about 2 min 25 s to go"
    other = workflow("status", str(with_log(runs / "b", [planned(0, steps=900), *meshing]))).stdout
    assert other.splitlines()[-3:] == [
        "then: report 15 s, estimated from earlier runs",
        "in all: at least 45 s to go",
        "unknown: the time of training; no run in this folder has finished this with these "
        "settings",
    ]


def test_a_run_names_its_stages_for_the_status(
    workflow: Workflow, tiny_run: Path, tmp_path: Path
) -> None:
    """As it would be in the middle of the correspondence, beside the same run, finished."""
    whole = (tiny_run / "run.jsonl").read_text()
    begun = whole[: whole.index('"stage started", "stage": "correspondence"')]
    cut = tmp_path / "runs" / "cut"
    cut.mkdir(parents=True)
    line = whole[len(begun) :].splitlines()[0]
    (cut / "run.jsonl").write_text(begun + line + "\n")
    (tmp_path / "runs" / "whole").mkdir()
    (tmp_path / "runs" / "whole" / "run.jsonl").write_text(whole)
    then, in_all = workflow("status", str(cut)).stdout.splitlines()[-2:]
    assert [part.split()[0] for part in then.removeprefix("then: ").split(", ")][:4] == [
        "groupwise", "shape_model", "evaluation", "report"
    ]  # fmt: skip
    assert in_all.startswith("in all: about ")


def test_the_log_holds_what_was_said_and_the_traceback_of_a_fault(tmp_path: Path) -> None:
    log = RunLog(tmp_path)
    with pytest.raises(ZeroDivisionError) as error, log.kept_errors():
        _ = 1 / 0
    assert "_ = 1 / 0" in (tmp_path / "run.log").read_text()
    assert error.value.__notes__ == [f"The traceback is in {tmp_path / 'run.log'}."]


def test_doctor_names_what_a_report_needs(workflow: Workflow) -> None:
    said = workflow("doctor").stdout
    for name in ("python", "torch", "gpu", "cores", "disk", "meshing", "pictures"):
        assert any(line.startswith(name) for line in said.splitlines()), name


def test_forget_leaves_no_trace_and_the_next_run_leaves_the_case_out(
    workflow: Workflow, tiny_run: Path, tmp_path: Path
) -> None:
    masks = write_balls(tmp_path / "masks", 5)
    folder = run_tiny(masks, tmp_path / "runs")
    export = tmp_path / "elsewhere"
    assert workflow("export", NAME, "--to", str(export), "--format", "csv").code == 0
    kept = {path: path.read_bytes() for path in folder.glob("meshing/*/mesh.npz")}
    settings = (folder / "study.yaml").read_text()
    (folder / "study.yaml").write_text(settings.replace("template: null", "template: ball_1"))
    said = workflow("forget", "ball_1", "--run", str(folder))
    assert said.code == 0, said.stderr
    assert str(export) in said.stdout
    names = [path for path in folder.rglob("*") if "ball_1" in path.name]
    holding = [p for p in folder.rglob("*") if p.is_file() and b"ball_1" in p.read_bytes()]
    assert names == holding == []
    assert "template: ball_1" not in (folder / "study.yaml").read_text()
    assert read_run_settings(folder).meshing.faces == 600
    assert "withdrawn" in (folder / "report" / "index.html").read_text()
    (masks / "ball_1.nii.gz").rename(masks / "renamed.nii.gz")
    run_study(NAME, tiny_settings(masks), RunOptions(folder.parent), Terminal())
    assert not [p for p in folder.rglob("*") if p.is_file() and b"renamed" in p.read_bytes()]
    for path, content in kept.items():
        assert path.exists() == ("ball_1" not in path.parts), path
        assert "ball_1" in path.parts or path.read_bytes() == content
    with pytest.raises(StudyError, match="has no case ball_1"):
        forget_case("ball_1", folder)


def test_a_second_export_holds_nothing_of_a_case_left_out_since(
    workflow: Workflow, tiny_run: Path, tmp_path: Path
) -> None:
    masks = write_balls(tmp_path / "masks", 5)
    export, options = tmp_path / "export", RunOptions(tmp_path / "runs")
    settings = without_comparison(tiny_settings(masks))
    folder = run_study(NAME, settings, options, Terminal())
    assert workflow("export", NAME, "--to", str(export), "--format", "shapeworks,npz").code == 0
    mine = export / "notes.txt"
    mine.write_text("mine")
    (masks / "ball_1.nii.gz").unlink()
    run_study(NAME, settings, options, Terminal())
    assert [path for path in folder.rglob("*") if "ball_1" in path.name] == []
    assert workflow("export", NAME, "--to", str(export), "--format", "shapeworks").code == 0
    assert [path for path in export.rglob("*") if "ball_1" in path.name] == []
    assert not (export / "model.npz").exists()  # of the former model
    assert mine.exists()


def test_a_mistyped_option_is_a_usage_message(workflow: Workflow) -> None:
    said = workflow("run", "--nope")
    assert said.code == 2
    assert "No such option" in said.stderr
    assert "fault" not in said.stderr


def test_a_traceback_is_shown_with_debug_only(workflow: Workflow) -> None:
    assert "Traceback" not in workflow("show", "nope").stderr
    assert "Traceback" in workflow("show", "nope", "--debug").stderr


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_closed_to_us_is_one_message(workflow: Workflow, tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir(mode=0o500)
    said = workflow("run", "luna16")
    assert said.code == 1
    assert "Permission denied" in said.stderr
    assert "Traceback" not in said.stderr


def test_a_runs_folder_that_is_a_file_is_one_message(workflow: Workflow, tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("mine")
    said = workflow("run", "luna16")
    assert said.code == 1
    assert said.stderr.startswith("error: ")
    assert "runs" in said.stderr
    assert "Traceback" not in said.stderr
    assert (tmp_path / "runs").read_text() == "mine"


def test_ctrl_c_says_that_what_is_finished_is_kept(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "ssm_pipeline", "run", "luna16"]
    run = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    until = time.monotonic() + 120
    while not (tmp_path / "runs").exists() and time.monotonic() < until:
        time.sleep(0.05)
    run.send_signal(signal.SIGINT)
    _, said = run.communicate(timeout=300)  # two libraries may still be on their way in
    assert run.returncode == 130, said
    assert said.strip().endswith("run the same command to go on.")
    assert "Traceback" not in said

"""What is damaged or missing in a run's folder is found and made again, and nothing else is."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from faults import results_in
from test_runner import GOOD, Bench
from toy_study import write_masks

from ssm_pipeline.engine.left_files import damaged_files
from ssm_pipeline.engine.run_log import RunLog, read_events
from ssm_pipeline.engine.stage import StageRecord
from ssm_pipeline.engine.withdrawn import WITHDRAWN_FILE, withdraw
from ssm_pipeline.records import StudyError


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    write_masks(tmp_path / "masks", GOOD)
    bench = Bench(tmp_path)
    bench.run()
    return bench


def run_folder(bench: Bench) -> Path:
    folder: Path = bench.folder / "runs" / "toy"
    return folder


def harm(path: Path, how: str) -> None:
    content = path.read_bytes()
    if how == "gone":
        path.unlink()
    elif how == "empty":
        path.write_bytes(b"")
    elif how == "cut":
        path.write_bytes(content[: len(content) // 2])
    elif how == "other":
        path.write_bytes(b"\xff" * len(content))


FILES = {
    "double/b/doubled.txt": ["b"],
    "double/b/case.json": ["b"],
    "double/doubled.csv": [],
    "double/stage.json": [],
    "sum/sum.txt": [],
    "sum/stage.json": [],
    "study.json": [],
    "study.yaml": [],
}


@pytest.mark.parametrize("how", ["gone", "empty", "cut"])
@pytest.mark.parametrize("name", FILES)
def test_a_damaged_file_is_made_again_and_no_other_case_is(
    bench: Bench, name: str, how: str
) -> None:
    whole = results_in(run_folder(bench))
    harm(run_folder(bench) / name, how)
    bench.run()
    assert bench.worked_on == FILES[name]
    assert results_in(run_folder(bench)) == whole
    assert "nothing to do" in bench.run()


def test_records_of_json_but_not_ours_are_made_again(bench: Bench) -> None:
    for name in ("double/stage.json", "double/b/case.json"):
        for content in ("[]", "{}", '{"key": 1}', "null"):
            (run_folder(bench) / name).write_text(content)
            bench.run()
            assert bench.sum == "20"


def test_a_change_that_keeps_the_size_is_found_by_content_only(bench: Bench) -> None:
    harm(run_folder(bench) / "double/b/doubled.txt", "other")
    folder = run_folder(bench) / "double"
    record = StageRecord.read(folder)
    assert record is not None
    assert not damaged_files(folder, record.files)
    (error,) = damaged_files(folder, record.files, by_content=True)
    assert error.path == folder / "b" / "doubled.txt"


def test_what_a_stage_left_is_of_its_own_files_and_its_cases_records(bench: Bench) -> None:
    assert set(bench.stage_json("double")["files"]) == {
        "doubled.csv",
        *(f"{case}/case.json" for case in GOOD),
    }


def test_the_folder_of_a_lost_owner_is_still_of_its_own_masks(bench: Bench) -> None:
    (run_folder(bench) / "study.json").unlink()
    (run_folder(bench) / "run.jsonl").unlink()
    with pytest.raises(StudyError, match="log does not say which study"):
        bench.run()


def test_a_case_left_out_of_the_cohort_is_deleted_from_the_run(bench: Bench) -> None:
    (bench.masks / "b.txt").unlink()
    write_masks(bench.masks, {"e": "5"})
    said = bench.run()
    assert "1 case is no longer part of the study; the results were deleted" in said
    assert not (run_folder(bench) / "double" / "b").exists()
    assert bench.worked_on == ["e"]
    assert bench.sum == "26"


def test_a_record_that_names_files_elsewhere_has_none_of_them_deleted(bench: Bench) -> None:
    precious = bench.folder / "case.json"  # beside the folder of runs
    precious.write_text("mine")
    for record in ("double/stage.json", "double/b/case.json"):
        path = run_folder(bench) / record
        for name in (str(precious), "../../../case.json", "../../../../case.json"):
            content = json.loads(path.read_text())
            content["files"][name] = [1, "0"]
            path.write_text(json.dumps(content))
            bench.run()
            assert precious.read_text() == "mine"
    assert bench.sum == "20"


@pytest.mark.parametrize("content", ["", "{", "5", "[5]", "{}"])
def test_no_damage_takes_back_who_withdrew(bench: Bench, content: str) -> None:
    """Other damaged files are made again; of this one there is no other copy."""
    write_masks(bench.masks, {"e": "5"})
    keys = json.loads((run_folder(bench) / "study.json").read_text())["cases"]
    withdraw(run_folder(bench), keys["b"])
    bench.run()
    path = run_folder(bench) / WITHDRAWN_FILE
    path.write_text(content)
    with pytest.raises(StudyError, match="lists the cases that were withdrawn"):
        bench.run()
    assert path.read_text() == content
    assert bench.worked_on == []


def test_a_line_of_the_log_cut_short_does_not_swallow_the_next(bench: Bench) -> None:
    log = run_folder(bench) / "run.jsonl"
    before = list(read_events(run_folder(bench)))
    log.write_bytes(log.read_bytes()[:-9])
    RunLog(run_folder(bench)).event("run", study="toy")
    after = list(read_events(run_folder(bench)))
    assert after[:-1] == before[:-1]
    assert after[-1]["study"] == "toy"


@pytest.mark.parametrize("cases", [5, ["a"], {"a": 1}])
def test_an_owner_of_another_kind_is_read_from_the_log(bench: Bench, cases: object) -> None:
    path = run_folder(bench) / "study.json"
    whole = json.loads(path.read_text())
    path.write_text(json.dumps(whole | {"cases": cases}))
    assert "nothing to do" in bench.run()
    assert json.loads(path.read_text()) == whole

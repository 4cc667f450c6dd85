"""The runner on toy stages: cached, continued after a kill, cases dropped, folders kept apart."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest
from toy_bench import GOOD, Bench
from toy_study import write_masks

from ssm_pipeline.engine import process
from ssm_pipeline.engine.per_case import CaseFailure, CaseTask, map_cases
from ssm_pipeline.engine.workers import Processes
from ssm_pipeline.records import StudyError


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    write_masks(tmp_path / "masks", GOOD)
    return Bench(tmp_path)


def test_a_run_says_a_line_a_stage_and_leaves_its_record(bench: Bench) -> None:
    said = bench.run()
    assert bench.sum == "20"
    assert [line.split()[:2] for line in said.splitlines()] == [
        ["[1/3]", "data"],
        ["[2/3]", "double"],
        ["[3/3]", "sum"],
    ]
    record = bench.stage_json("double")
    assert record["settings"]["faces"] == 1000
    assert record["cases_out"] == ["a", "b", "c", "d"]
    assert record["inputs"] == {"data": bench.stage_json("data")["key"]}
    assert record["peak_memory_mb"] > 10
    assert record["versions"]["numpy"]
    table = pd.read_csv(bench.folder / "runs/toy/double/doubled.csv")
    assert list(table["doubled"]) == [2, 4, 6, 8]


def test_a_second_run_does_nothing_and_says_so(bench: Bench) -> None:
    bench.run()
    before = bench.stage_json("sum")
    said = bench.run()
    assert bench.worked_on == []
    assert "nothing to do" in said
    assert bench.stage_json("sum") == before


def test_only_what_depends_on_a_change_is_done_again(bench: Bench) -> None:
    bench.run()
    assert "up to date" in bench.run(seed=1)  # only `sum` has the seed among its settings
    assert bench.worked_on == []
    bench.run(seed=1, faces=500)
    assert bench.worked_on == ["a", "b", "c", "d"]
    write_masks(bench.masks, {"b": "20"})
    bench.run(seed=1, faces=500)
    assert bench.worked_on == ["b"]
    assert bench.sum == "56"
    write_masks(bench.masks, {"e": "5"})
    bench.run(seed=1, faces=500)
    assert bench.worked_on == ["e"]
    assert bench.sum == "66"


def test_a_touched_or_moved_file_of_the_same_content_is_no_change(bench: Bench) -> None:
    bench.run()
    os.utime(bench.masks / "a.txt", (0, 0))
    bench.masks = bench.masks.rename(bench.folder / "moved")
    assert "nothing to do" in bench.run()


def test_processes_give_what_one_process_gives(bench: Bench, tmp_path: Path) -> None:
    bench.run(jobs=2)
    assert sorted(bench.worked_on) == ["a", "b", "c", "d"]
    assert bench.sum == "20"
    assert bench.stage_json("double")["cases_out"] == ["a", "b", "c", "d"]  # in order, always


def test_a_bad_case_is_dropped_with_its_reason_and_not_tried_again(bench: Bench) -> None:
    write_masks(bench.masks, {"b": "bad", "e": "5"})
    said = bench.run()
    assert "4 of 5 cases" in said
    assert "      dropped b: no number found; a number is needed." in said.splitlines()
    assert bench.sum == "26"
    assert bench.stage_json("double")["dropped"] == [
        {"case_id": "b", "stage": "double", "reason": "no number found; a number is needed."}
    ]
    assert "dropped b" in bench.run()
    assert bench.worked_on == []


def test_fewer_than_four_cases_end_the_run_with_every_reason(bench: Bench) -> None:
    write_masks(bench.masks, {"b": "bad", "c": "bad"})
    with pytest.raises(StudyError, match=r"2 usable cases(?s:.)*b \(double\): no number"):
        bench.run()
    write_masks(bench.masks, {"b": "2", "c": "3"})
    bench.run()
    assert bench.worked_on == ["b", "c"]


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_bug_names_the_case_and_leaves_the_rest_finished(bench: Bench, jobs: int) -> None:
    write_masks(bench.masks, {"d": "bug"})
    with pytest.raises(CaseFailure, match=r"case d: ValueError.*bug") as failure:
        bench.run(jobs=jobs)
    assert "int(text)" in failure.value.worker_traceback
    write_masks(bench.masks, {"d": "4"})
    bench.run(jobs=1)
    assert "d" in bench.worked_on
    assert bench.sum == "20"
    if jobs == 1:
        assert bench.worked_on == ["d"]


def test_after_a_kill_the_next_run_goes_on_with_the_case_it_hit(bench: Bench) -> None:
    write_masks(bench.masks, {"c": "kill"})  # the toy turns it into 7 before it dies
    run = multiprocessing.get_context("fork").Process(target=bench.run)
    run.start()
    run.join(60)
    assert run.exitcode == -9
    assert bench.worked_on == ["a", "b", "c"]
    bench.run()
    assert bench.worked_on == ["c", "d"]
    assert bench.sum == "28"


def test_a_killed_worker_is_explained_and_the_next_run_goes_on(bench: Bench) -> None:
    write_masks(bench.masks, {"c": "kill"})
    with pytest.raises(StudyError, match="because memory ran out"):
        bench.run(jobs=2)
    bench.run()
    assert "c" in bench.worked_on
    assert bench.sum == "28"


KEPT: list[bytes] = []  # in a worker


def keep_memory(folder: Path) -> dict[str, int]:
    KEPT.append(b"1" * 200_000_000)
    time.sleep(0.6)  # joblib looks at a worker's memory once a second
    return {"process": os.getpid()}


def test_a_worker_may_grow_without_being_taken_for_a_leak(tmp_path: Path) -> None:
    """joblib would end it at 300 MB, and warn, which is an error here."""
    tasks = [CaseTask(str(number), "key", keep_memory) for number in range(8)]
    results = map_cases(tasks, tmp_path, Processes(2))
    assert len({result.row["process"] for result in results}) == 2


def start_and_wait(parent_file: Path, child_file: Path) -> None:
    """A parent with two workers, each of which writes its id and waits for good."""
    from joblib import Parallel, delayed

    parent_file.write_text(str(os.getpid()))
    Parallel(n_jobs=2)(delayed(wait_for_good)(child_file, n, os.getpid()) for n in range(2))


def wait_for_good(child_file: Path, number: int, parent: int) -> None:
    process.end_with_parent(parent)
    child_file.with_suffix(f".{number}").write_text(str(os.getpid()))
    time.sleep(100)


def test_workers_end_with_a_killed_run(tmp_path: Path) -> None:
    parent_file, child_file = tmp_path / "parent", tmp_path / "child"
    code = (
        f"import sys; sys.path[:0] = [{str(Path(__file__).parent)!r}]\n"
        "import cloudpickle, toy_study, test_runner, pathlib\n"
        "cloudpickle.register_pickle_by_value(test_runner)\n"
        f"test_runner.start_and_wait(*map(pathlib.Path, {[str(parent_file), str(child_file)]}))\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", code])
    children = [child_file.with_suffix(f".{number}") for number in range(2)]
    until = time.monotonic() + 60
    while not all(path.exists() and path.read_text() for path in children):
        assert time.monotonic() < until, "the workers did not start"
        time.sleep(0.1)
    parent.kill()
    parent.wait()
    alive = {int(path.read_text()) for path in children}
    until = time.monotonic() + 20
    while alive and time.monotonic() < until:
        alive = {pid for pid in alive if Path(f"/proc/{pid}").exists()}
        time.sleep(0.1)
    assert not alive


def test_a_stage_cut_off_leaves_no_later_stage_looking_finished(bench: Bench) -> None:
    bench.run()
    write_masks(bench.masks, {"d": "bug"})
    with pytest.raises(CaseFailure):
        bench.run()
    finished = {path.parent.name for path in (bench.folder / "runs/toy").glob("*/stage.json")}
    assert finished == {"data"}


def test_a_half_written_stage_record_can_not_exist(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.run()
    before = bench.stage_json("sum")

    def full_disk(self: Path, target: Path) -> Path:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", full_disk)
        with pytest.raises(StudyError, match="No space left"):
            bench.run(seed=5)
    assert bench.stage_json("sum") == before
    assert not list((bench.folder / "runs/toy").rglob(".*json*"))  # no leftovers
    bench.run(seed=5)
    assert bench.stage_json("sum")["key"] != before["key"]


def test_a_folder_of_other_masks_is_refused(bench: Bench) -> None:
    bench.run()
    other = Bench(bench.folder)
    other.masks = bench.folder / "other"
    write_masks(other.masks, {"w": "5", "x": "10", "y": "20", "z": "30"})
    with pytest.raises(
        StudyError, match=r"results of the masks in .*masks, but this run uses .*other"
    ):
        other.run()
    assert bench.sum == "20"


def test_a_folder_that_is_no_run_is_refused(bench: Bench) -> None:
    precious = bench.folder / "runs" / "toy" / "thesis.txt"
    precious.parent.mkdir(parents=True)
    precious.write_text("mine")
    with pytest.raises(StudyError, match=r"thesis\.txt"):
        bench.run()
    assert [path.name for path in precious.parent.iterdir()] == ["thesis.txt"]


def test_a_renamed_run_of_another_study_is_refused(bench: Bench) -> None:
    bench.run(name="first")
    (bench.folder / "runs" / "first").rename(bench.folder / "runs" / "toy")
    with pytest.raises(StudyError, match="belongs to the study first, not toy"):
        bench.run()


def test_two_runs_at_a_time_in_one_folder_are_refused(bench: Bench) -> None:
    from ssm_pipeline.engine.ownership import alone_in

    with alone_in(bench.folder / "runs" / "toy"):
        with pytest.raises(StudyError, match="another process is writing to"):
            bench.run()
    assert "[3/3]" in bench.run()


def test_three_cases_are_too_few_before_any_work(bench: Bench) -> None:
    (bench.masks / "d.txt").unlink()
    with pytest.raises(StudyError, match="3 cases were found; a shape model needs at least 4"):
        bench.run()
    assert bench.worked_on == []


def test_copies_of_one_file_are_refused_before_any_work(bench: Bench) -> None:
    write_masks(bench.masks, dict.fromkeys(GOOD, "1"))
    with pytest.raises(StudyError, match="all 4 cases are copies of one file"):
        bench.run()
    assert bench.worked_on == []

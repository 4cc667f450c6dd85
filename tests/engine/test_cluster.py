"""Cases on a Dask cluster: a real scheduler and real workers on loopback, killed and unfit ones."""

from __future__ import annotations

import multiprocessing
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from command_line import Workflow
from dask_bench import DaskBench
from faults import results_in
from toy_bench import Bench
from toy_study import hold, write_masks

pytest.importorskip("distributed")

from ssm_pipeline.engine import cluster as module
from ssm_pipeline.engine import process
from ssm_pipeline.engine.cluster import DaskCluster, Here, connected
from ssm_pipeline.engine.per_case import CaseFailure, CaseTask, map_cases
from ssm_pipeline.records import StudyError

NUMBERS = {f"case_{index:02d}": str(index + 1) for index in range(30)}


@pytest.fixture(scope="module")
def dask(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskBench]:
    with DaskBench(tmp_path_factory.mktemp("dask")) as bench:
        yield bench


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    write_masks(tmp_path / "masks", NUMBERS)
    return Bench(tmp_path)


def test_two_workers_leave_what_one_machine_leaves(
    dask: DaskBench, bench: Bench, tmp_path: Path
) -> None:
    with connected(dask.address) as client:
        bench.run(cluster=DaskCluster(client))
    assert sorted(bench.worked_on) == sorted(NUMBERS)
    on_cluster = results_in(tmp_path / "runs" / "toy")
    (tmp_path / "runs").rename(tmp_path / "runs on cluster")
    bench.run()
    assert on_cluster == results_in(tmp_path / "runs" / "toy")


def test_a_worker_killed_at_work_loses_no_case(dask: DaskBench, bench: Bench) -> None:
    write_masks(bench.masks, {"case_11": "kill"})  # kills the worker, and is 7 afterwards
    with connected(dask.address) as client:
        bench.run(cluster=DaskCluster(client))
        assert bench.worked_on.count("case_11") == 2
        assert set(bench.worked_on) == set(NUMBERS)
        assert int(bench.sum) == 2 * (sum(map(int, NUMBERS.values())) - 12 + 7)
        bench.run(cluster=DaskCluster(client))
    assert bench.worked_on == ["case_11"]  # whose file is another now; no other is redone


def test_errors_come_back_as_from_processes(dask: DaskBench, bench: Bench) -> None:
    write_masks(bench.masks, {"case_03": "bad"})
    with connected(dask.address) as client:
        said = bench.run(cluster=DaskCluster(client))
        assert "dropped case_03: no number found" in said
        write_masks(bench.masks, {"case_04": "bug"})
        with pytest.raises(CaseFailure, match=r"case case_04: ValueError.*bug"):
            bench.run(cluster=DaskCluster(client))


def test_what_a_killed_run_left_at_work_is_waited_for(dask: DaskBench, tmp_path: Path) -> None:
    """Its worker goes on until its case is done, and would write beside the run that takes over."""
    begun, ended = tmp_path / "begun", tmp_path / "ended"
    folder = tmp_path / "stage"
    folder.mkdir()

    def first_run() -> None:
        with connected(dask.address) as client:
            work = partial(hold, begun, ended, 8.0)
            map_cases([CaseTask("a", "old", work)], folder, DaskCluster(client))

    run = multiprocessing.get_context("fork").Process(target=first_run)
    run.start()
    until = time.monotonic() + 60
    while not begun.exists():
        assert time.monotonic() < until
        time.sleep(0.1)
    run.kill()
    run.join()
    said: list[str] = []
    with connected(dask.address) as client:
        work = partial(hold, tmp_path / "begun again", tmp_path / "ended again", 0.0)
        map_cases([CaseTask("a", "new", work)], folder, DaskCluster(client, say=said.append))
    assert ended.exists()
    assert said == ["waiting for 1 case that an earlier run still processes"]
    assert '"new"' in (folder / "a" / "case.json").read_text()


def test_a_scheduler_that_is_gone_ends_the_run_with_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "dask").mkdir()
    (tmp_path / "stage").mkdir()
    with DaskBench(tmp_path / "dask", workers=1) as dask, connected(dask.address) as client:
        begun = tmp_path / "begun"
        work = partial(hold, begun, tmp_path / "ended", 60.0)
        with dask.killed_when(dask.scheduler, begun.exists):
            with pytest.raises(StudyError, match="the scheduler has stopped or cancelled the work"):
                map_cases([CaseTask("a", "key", work)], tmp_path / "stage", DaskCluster(client))


def test_no_scheduler_no_worker_no_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, workflow: Workflow
) -> None:
    monkeypatch.setattr(module, "CONNECT_S", 1.0)
    monkeypatch.setattr(module, "WORKER_S", 1.0)
    said = workflow("run", "phantoms", "--cluster", "tcp://127.0.0.1:1")
    assert said.code == 1
    assert "tcp://127.0.0.1:1: no Dask scheduler answers there" in said.stderr
    with DaskBench(tmp_path, workers=0) as dask:
        with pytest.raises(StudyError, match=r"has no workers\. Start some with: dask worker tcp"):
            connected(dask.address).__enter__()
    said = workflow("run", "phantoms", "--cluster", "nowhere")
    assert "nowhere: give the address of a Dask scheduler" in said.stderr
    monkeypatch.setitem(sys.modules, "distributed", None)
    said = workflow("run", "phantoms", "--cluster", "tcp://127.0.0.1:1")
    assert "pip install 'ssm-pipeline[cluster]'" in said.stderr


def test_a_worker_with_two_threads_is_refused(tmp_path: Path, bench: Bench) -> None:
    (tmp_path / "dask").mkdir()
    with DaskBench(tmp_path / "dask", workers=0) as dask:
        dask.workers.append(dask.add_worker(threads=2))
        with connected(dask.address) as client:
            with pytest.raises(StudyError, match=r"has 2 threads and .* --nthreads 1"):
                bench.run(cluster=DaskCluster(client))
    assert bench.worked_on == []


def test_workers_that_are_all_lost_end_the_run_after_a_while(tmp_path: Path, bench: Bench) -> None:
    (tmp_path / "dask").mkdir()
    (tmp_path / "stage").mkdir()
    with DaskBench(tmp_path / "dask", workers=1) as dask, connected(dask.address) as client:
        begun = tmp_path / "begun"
        work = partial(hold, begun, tmp_path / "ended", 60.0)
        workers = DaskCluster(client, wait_s=2.0)
        with dask.killed_when(dask.workers[0], begun.exists):
            with pytest.raises(StudyError, match="no workers left"):
                map_cases([CaseTask("a", "key", work)], tmp_path / "stage", workers)


def test_a_worker_without_the_program_is_named(tmp_path: Path, bench: Bench) -> None:
    (tmp_path / "dask").mkdir()
    (tmp_path / "ssm_pipeline.py").write_text("raise ImportError('nothing of it is here')")
    with DaskBench(tmp_path / "dask", workers=0) as dask:
        dask.workers.append(dask.add_worker(paths=str(tmp_path)))
        with connected(dask.address) as client:
            with pytest.raises(
                StudyError, match=r"worker tcp.* can't import ssm_pipeline: .*nothing of it"
            ):
                bench.run(cluster=DaskCluster(client))


def test_a_worker_that_sees_other_folders_or_has_other_versions_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in process.THREAD_COUNTS:
        monkeypatch.setenv(name, "1")
    monkeypatch.chdir(tmp_path)
    worker: Any = SimpleNamespace(address="tcp://far:1", state=SimpleNamespace(nthreads=1))
    ours = process.versions()
    (tmp_path / "stage").mkdir()
    refuse = partial(module._refuse_unlike, worker)
    refuse(Here(tmp_path, ours | {"platform": "another kernel"}), Path("stage"))
    with pytest.raises(StudyError, match=r"tcp://far:1 does not see .*other/stage"):
        refuse(Here(tmp_path / "other", ours), Path("stage"))
    with pytest.raises(StudyError, match=r"does not see .*elsewhere"):
        refuse(Here(tmp_path, ours), Path("elsewhere"))
    with pytest.raises(StudyError, match=r"has numpy .*; this run has numpy 0\.1"):
        refuse(Here(tmp_path, ours | {"numpy": "0.1"}), Path("stage"))
    monkeypatch.setenv("OMP_NUM_THREADS", "4")
    with pytest.raises(StudyError, match=r"OMP_NUM_THREADS=4\. It must have 1 thread"):
        refuse(Here(tmp_path, ours), Path("stage"))


def test_files_that_never_show_up_here_end_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A worker whose folder has the same name and is another one."""
    monkeypatch.setattr(module, "SHARED_S", 1.0)
    done: Any = SimpleNamespace(result=lambda: "what a worker says")
    with pytest.raises(StudyError, match=r"a\. Put the runs folder on a disk"):
        module._result(done, CaseTask("a", "key", lambda folder: {}), tmp_path)

"""Processes that work on a case each: their memory is capped, and each has one thread."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import psutil
import pytest
from toy_study import count_threads, take_memory

from ssm_pipeline.engine import process
from ssm_pipeline.engine.per_case import CaseTask, Workers, here, map_cases
from ssm_pipeline.engine.workers import Processes
from ssm_pipeline.records import StudyError

HERE = Path(__file__).parent
capped_only = pytest.mark.skipif(
    not hasattr(psutil, "RLIMIT_DATA"), reason="the system knows no such limit"
)


@capped_only
@pytest.mark.parametrize(
    ("capped", "free"),
    [(partial(here, memory_gb=2.0), here), (Processes(2, memory_gb=2.0), Processes(2))],
)
def test_a_case_that_wants_more_memory_ends_the_run_and_is_not_dropped(
    tmp_path: Path, capped: Workers, free: Workers
) -> None:
    tasks = [CaseTask("small", "key", partial(take_memory, 10))]
    tasks += [CaseTask("large", "key", partial(take_memory, 3000))]
    with pytest.raises(
        StudyError, match=r"case large: .* ran out of memory at .* GB \(--memory-gb 2\)"
    ):
        map_cases(tasks, tmp_path / "stage", capped)
    done: list[str] = []
    results = map_cases(tasks, tmp_path / "stage", free, on_result=lambda r: done.append(r.case_id))
    assert "large" in done
    assert [result.dropped for result in results] == [None, None]


def test_a_worker_has_one_thread_for_every_library(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in process.THREAD_COUNTS:
        monkeypatch.setenv(name, "3")  # what the machine says; a worker has its own
    tasks = [CaseTask(case_id, "key", count_threads) for case_id in ("a", "b")]
    rows = [result.row for result in map_cases(tasks, tmp_path / "stage", Processes(2))]
    assert rows == 2 * [dict.fromkeys(("pykdtree", "scipy", "torch"), 0)]


def test_without_that_the_libraries_take_more(tmp_path: Path) -> None:
    """Or the test above would pass whatever a worker does."""
    code = "import sys, toy_study, pathlib; print(toy_study.count_threads(pathlib.Path()))"
    said = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **dict.fromkeys(process.THREAD_COUNTS, "3"), "PYTHONPATH": str(HERE)},
        capture_output=True,
        text=True,
        check=True,
    )
    more = eval(said.stdout)
    assert max(more.values()) > 0, more

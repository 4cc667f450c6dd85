"""Work spread over processes: order, and one thread each."""

from __future__ import annotations

import os
import time

import joblib
import pytest

from ssm_pipeline.parallel import in_processes


def _late_if_first(number: int) -> tuple[int, int]:
    time.sleep(0.5 if number == 0 else 0)
    return number, os.getpid()


def _threads() -> str | None:
    return os.environ.get("OMP_NUM_THREADS")


def test_results_keep_the_order_of_the_tasks() -> None:
    results = list(in_processes(map(joblib.delayed(_late_if_first), range(4)), jobs=2))
    assert [number for number, _ in results] == [0, 1, 2, 3]
    assert os.getpid() not in {process for _, process in results}


def test_unordered_results_come_as_they_are_ready() -> None:
    tasks = map(joblib.delayed(_late_if_first), range(4))
    results = list(in_processes(tasks, jobs=2, ordered=False))
    assert results[0][0] != 0
    assert sorted(number for number, _ in results) == [0, 1, 2, 3]


def test_each_process_has_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    tasks = [joblib.delayed(_threads)() for _ in range(2)]
    assert list(in_processes(tasks, jobs=2)) == ["1", "1"]

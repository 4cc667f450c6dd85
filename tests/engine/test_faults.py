"""The toy run with every fault at every write, resumed. Of a real run: `make test-slow`."""

from __future__ import annotations

import itertools
import time
from pathlib import Path

import pytest
from faults import (
    FAULTS,
    moments,
    results_in,
    resumes_as_if_nothing_had_been,
    run_and_kill,
    run_with_fault,
    writes_of,
)
from toy_bench import GOOD, Bench
from toy_study import write_masks


def bench_in(folder: Path) -> Bench:
    """On the same masks for all: a run notes where they were."""
    folder.mkdir()
    write_masks(folder.parent / "masks", GOOD)
    bench = Bench(folder)
    bench.masks = folder.parent / "masks"
    return bench


@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_at_every_write_is_survived(tmp_path: Path, fault: str) -> None:
    undisturbed = bench_in(tmp_path / "undisturbed")
    writes = writes_of(undisturbed.run)
    whole = results_in(undisturbed.folder / "runs" / "toy")
    assert writes == 15  # owner, settings, three stages, a table, the sum, two files per case
    for number in range(1, writes + 1):
        bench = bench_in(tmp_path / str(number))
        assert run_with_fault(bench.run, fault, number)
        resumes_as_if_nothing_had_been(bench.run, bench.folder / "runs" / "toy", whole)


def test_kills_at_random_moments_are_survived(tmp_path: Path) -> None:
    undisturbed = bench_in(tmp_path / "undisturbed")
    start = time.perf_counter()
    run_and_kill(undisturbed.run, 60)
    seconds = time.perf_counter() - start
    whole = results_in(undisturbed.folder / "runs" / "toy")
    for number, moment in enumerate(moments(30, seconds, seed=0)):
        for attempt in itertools.count():  # through before that: the machine was slower when timed
            bench = bench_in(tmp_path / f"{number}-{attempt}")
            if run_and_kill(bench.run, moment * 0.9**attempt):
                break
        resumes_as_if_nothing_had_been(bench.run, bench.folder / "runs" / "toy", whole)


def test_the_harness_sees_a_file_that_stays_torn(tmp_path: Path) -> None:
    bench = bench_in(tmp_path / "bench")
    bench.run()
    folder = bench.folder / "runs" / "toy"
    whole = results_in(folder)
    (folder / "sum" / "sum.txt").write_text("2")
    with pytest.raises(AssertionError):
        resumes_as_if_nothing_had_been(lambda: None, folder, whole)

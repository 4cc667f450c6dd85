"""A real run, masks to report, killed at random moments and at every write: `make test-slow`."""

from __future__ import annotations

import shutil
import time
from dataclasses import dataclass
from functools import partial
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
from tiny_study import NAME, run_tiny, write_balls

LONG_ENOUGH_S = 1e6


@dataclass(frozen=True)
class Undisturbed:
    """What a run leaves, how many files it names, and how long it takes."""

    results: dict[str, bytes]
    writes: int
    seconds: float


@pytest.fixture(scope="module")
def masks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_balls(tmp_path_factory.mktemp("masks") / "masks")


@pytest.fixture(scope="module")
def undisturbed(masks: Path, tmp_path_factory: pytest.TempPathFactory) -> Undisturbed:
    runs, again = tmp_path_factory.mktemp("undisturbed"), tmp_path_factory.mktemp("timed")
    count = writes_of(lambda: run_tiny(masks, runs))
    start = time.perf_counter()
    assert not run_and_kill(lambda: run_tiny(masks, again), LONG_ENOUGH_S)
    seconds = time.perf_counter() - start
    results = results_in(runs / NAME)
    assert results == results_in(again / NAME)
    return Undisturbed(results, count, seconds)


@pytest.mark.slow
@pytest.mark.parametrize(("jobs", "kills"), [(1, 30), (2, 10)])
def test_killed_at_random_moments(
    masks: Path, undisturbed: Undisturbed, tmp_path: Path, jobs: int, kills: int
) -> None:
    """With two processes a run may be through before the last moments."""
    killed = 0
    for number, moment in enumerate(moments(kills, undisturbed.seconds, seed=jobs)):
        runs = tmp_path / str(number)

        def run(runs: Path = runs) -> object:
            return run_tiny(masks, runs, jobs=jobs)

        was_killed = run_and_kill(run, moment)
        resumes_as_if_nothing_had_been(
            partial(run_and_kill, run, LONG_ENOUGH_S), runs / NAME, undisturbed.results
        )
        killed += was_killed
        print(
            f"{jobs} at a time, {'killed' if was_killed else 'through'} after {moment:.1f} s: "
            "same bytes, no finished case redone",
            flush=True,
        )
        shutil.rmtree(runs)
    assert killed > kills // 2


@pytest.mark.slow
@pytest.mark.parametrize("turn", range(len(FAULTS)))
def test_a_fault_at_every_write(
    masks: Path, undisturbed: Undisturbed, tmp_path: Path, turn: int
) -> None:
    """The faults take turns from write to write; over all turns every fault is at every write."""
    for number in range(1, undisturbed.writes + 1):
        fault = FAULTS[(number + turn) % len(FAULTS)]
        runs = tmp_path / str(number)

        def run(runs: Path = runs) -> object:
            return run_tiny(masks, runs)

        assert run_with_fault(run, fault, number)
        resumes_as_if_nothing_had_been(
            partial(run_and_kill, run, LONG_ENOUGH_S), runs / NAME, undisturbed.results
        )
        print(
            f"{fault} at write {number} of {undisturbed.writes}: same bytes, no finished case "
            "redone",
            flush=True,
        )
        shutil.rmtree(runs)

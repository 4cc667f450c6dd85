"""A real run, masks to report, killed at random moments and at every write: `make test-slow`."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

import numpy as np
import pytest
from faults import (
    FAULTS,
    results_in,
    resumes_as_if_nothing_had_been,
    run_and_kill,
    run_with_fault,
    writes_of,
)
from tiny_study import NAME, run_tiny, write_balls

MOMENTS = 30


@pytest.fixture(scope="module")
def masks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_balls(tmp_path_factory.mktemp("masks") / "masks")


@pytest.fixture(scope="module")
def undisturbed(
    masks: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[dict[str, bytes], int, float]:
    """What a run leaves, how many files it names, and how long it takes (s)."""
    runs = tmp_path_factory.mktemp("undisturbed")
    start = time.perf_counter()
    count = writes_of(lambda: run_tiny(masks, runs))
    return results_in(runs / NAME), count, time.perf_counter() - start


@pytest.mark.slow
def test_killed_at_random_moments(masks: Path, undisturbed, tmp_path: Path):
    whole, _, seconds = undisturbed
    killed = 0
    for number, share in enumerate(np.random.default_rng(0).random(MOMENTS)):
        runs = tmp_path / str(number)
        killed += run_and_kill(lambda runs=runs: run_tiny(masks, runs), share * seconds)
        resumes_as_if_nothing_had_been(
            lambda runs=runs: run_and_kill(lambda: run_tiny(masks, runs), 1e6), runs / NAME, whole
        )
        print(f"killed after {share * seconds:.1f} s: same bytes, no finished case redone")
        shutil.rmtree(runs)
    assert killed > MOMENTS // 2


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_at_every_write(masks: Path, undisturbed, tmp_path: Path, fault: str):
    whole, writes, _ = undisturbed
    for number in range(1, writes + 1):
        runs = tmp_path / str(number)
        assert run_with_fault(lambda runs=runs: run_tiny(masks, runs), fault, number)
        resumes_as_if_nothing_had_been(
            lambda runs=runs: run_and_kill(lambda: run_tiny(masks, runs), 1e6), runs / NAME, whole
        )
        print(f"{fault} at write {number} of {writes}: same bytes, no finished case redone")
        shutil.rmtree(runs)

"""Runs that end badly: a process killed at a write or at a moment, a disk that fills or forgets.

The faults are put into `Path.replace`, by which `storage` gives every file its name, and only in a
process of their own.
"""

from __future__ import annotations

import errno
import importlib
import json
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

from ssm_pipeline import storage
from ssm_pipeline.records import StudyError

REFUSALS = {"full disk": errno.ENOSPC, "failing disk": errno.EIO, "read-only disk": errno.EROFS}
FAULTS = ("kill before", "kill after", "half written", "torn", "lost rename", *REFUSALS)
OF_THE_DAY = ("seconds", "peak_memory_mb", "finished_at", "ran_on")


def run_with_fault(run: Callable[[], object], fault: str, at_write: int) -> bool:
    """Run in a process of its own, with a fault at its n-th write. False if it came to its end.

    kill before, kill after   the process is killed just before or after a file gets its name
    half written              half of the content is there, under its temporary name
    torn, lost rename         and the file is cut in half, or is as it was before: a disk that says
                              it has written what it has not
    full, failing, read-only disk   the write fails; the process ends by itself, with one message
    """

    def disturbed() -> None:
        count = 0
        replace = Path.replace

        def faulty(self: Path, target: Path) -> Path:
            nonlocal count
            count += 1
            if count != at_write:
                return replace(self, target)
            if fault in REFUSALS:
                raise OSError(REFUSALS[fault], os.strerror(REFUSALS[fault]))
            before = target.read_bytes() if target.exists() else None
            if fault in ("kill after", "torn", "lost rename"):
                replace(self, target)
            if fault in ("half written", "torn"):
                harmed = target if fault == "torn" else self
                content = harmed.read_bytes()
                harmed.write_bytes(content[: len(content) // 2])
            elif fault == "lost rename":
                target.unlink()
                if before is not None:
                    target.write_bytes(before)
            os.kill(os.getpid(), signal.SIGKILL)
            raise AssertionError("killed")

        Path.replace = faulty  # type: ignore[method-assign, assignment]
        try:
            run()
        except StudyError as error:
            assert f"can't be written: {os.strerror(REFUSALS[fault])}" in str(error)  # noqa: PT017
            sys.exit(3)

    child = multiprocessing.get_context("fork").Process(target=disturbed)
    child.start()
    child.join()
    assert child.exitcode in (0, 3, -signal.SIGKILL)
    return child.exitcode != 0


def run_and_kill(run: Callable[[], object], after_s: float) -> bool:
    """Run in a process of its own and kill it after so many seconds. False if it was through."""
    child = multiprocessing.get_context("fork").Process(target=run)
    child.start()
    child.join(after_s)
    child.kill()
    child.join()
    return child.exitcode == -signal.SIGKILL


def moments(count: int, seconds: float, seed: int) -> list[float]:
    """Random moments of a run of so many seconds, one in each of `count` equal parts of it."""
    parts = np.arange(count) + np.random.default_rng(seed).random(count)
    return [float(moment) for moment in parts / count * seconds]


def writes_of(run: Callable[[], object]) -> int:
    """How many files a run gives a name.

    What it imports is imported here, too, so that the runs to come, forks of this process, are
    spared that: half of the time of a small one.
    """
    results, theirs = multiprocessing.Pipe(duplex=False)

    def counted() -> None:
        count = 0
        replace = Path.replace

        def counting(self: Path, target: Path) -> Path:
            nonlocal count
            count += 1
            return replace(self, target)

        Path.replace = counting  # type: ignore[method-assign, assignment]
        run()
        theirs.send((count, list(sys.modules)))

    child = multiprocessing.get_context("fork").Process(target=counted)
    child.start()
    count: int
    modules: list[str]
    count, modules = results.recv()
    child.join()
    for name in modules:
        with suppress(Exception):  # names of parts that are no modules, and of optional ones
            importlib.import_module(name)
    return count


def finished_cases(run_folder: Path) -> dict[Path, int]:
    """The folders of cases that are finished and whole, and when each was."""
    found = {}
    for record in run_folder.rglob("case.json"):
        try:
            files = storage.read_json(record)["files"]
        except (StudyError, KeyError, TypeError):
            continue
        if not storage.not_as_written(record.parent, files):
            found[record.parent] = record.stat().st_mtime_ns
    return found


def results_in(run_folder: Path) -> dict[str, bytes]:
    """What a run leaves, but for its log, times, memory and processes, which are of the day."""
    found = {}
    for path in sorted(run_folder.rglob("*")):
        if not path.is_file() or path.name in ("run.log", "run.jsonl", "index.html"):
            continue
        content = path.read_bytes()
        if path.name in ("stage.json", "case.json"):
            kept = json.loads(content)
            for name in OF_THE_DAY:
                kept.pop(name, None)
            of_the_day = ("case.json", "index.html")
            kept["files"] = {
                name: left for name, left in kept["files"].items() if not name.endswith(of_the_day)
            }
            content = json.dumps(kept).encode()
        found[path.relative_to(run_folder).as_posix()] = content
    return found


def resumes_as_if_nothing_had_been(
    run: Callable[[], object], run_folder: Path, undisturbed: dict[str, bytes]
) -> None:
    """The next run leaves what a run without a fault leaves, and redoes no finished case."""
    finished = finished_cases(run_folder)
    run()
    assert results_in(run_folder) == undisturbed
    redone = [folder for folder, when in finished_cases(run_folder).items()
              if finished.get(folder, when) != when]  # fmt: skip
    assert not redone
    assert not list(run_folder.rglob(".*")), "leftovers of unfinished writing"

"""Process one case at a time, and skip the cases that are finished.

A case's results lie in `<stage>/<case>/`. Its `case.json` is written last and holds the key of
everything the results depend on. A case is finished if that file exists and has the same key.
"""

from __future__ import annotations

import dataclasses
import shutil
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from ssm_pipeline import storage
from ssm_pipeline.engine.left_files import CASE_FILE, files_of_case
from ssm_pipeline.engine.memory import (
    forget_peak_memory,
    is_want_of_memory,
    memory_capped,
    peak_memory_mb,
)
from ssm_pipeline.records import CaseError, StudyError

Row = dict[str, Any]  # one line of a stage's table: column name → number, text or None


@dataclass(frozen=True)
class CaseTask:
    """`work(folder)` writes a case's files into its folder and returns its row."""

    case_id: str
    key: str
    work: Callable[[Path], Row]


@dataclass(frozen=True)
class CaseResult:
    """The result of a case; `dropped` is the reason why it was dropped, or None."""

    case_id: str
    key: str
    row: Row = field(default_factory=dict)
    seconds: float = 0.0
    peak_memory_mb: float = 0.0
    dropped: str | None = None
    files: storage.Fingerprints = field(default_factory=dict)


_case_result = TypeAdapter(CaseResult)


class CaseFailure(RuntimeError):
    """A fault of the program on a case, with the worker's traceback."""

    def __init__(self, case_id: str, worker_traceback: str) -> None:
        last_line = worker_traceback.strip().splitlines()[-1]
        super().__init__(f"case {case_id}: {last_line}")
        self.case_id, self.worker_traceback = case_id, worker_traceback

    def __reduce__(self) -> tuple[type, tuple[str, str]]:
        return type(self), (self.case_id, self.worker_traceback)


Workers = Callable[[Sequence[CaseTask], Path], Iterator[CaseResult]]  # tasks, stage's folder


def map_cases(
    tasks: Sequence[CaseTask],
    stage_folder: Path,
    workers: Workers,
    on_progress: Callable[[int], None] = lambda done: None,
    on_result: Callable[[CaseResult], None] = lambda result: None,
) -> list[CaseResult]:
    """Do the tasks that are not finished, and return all results in the order of the tasks.

    Args:
        workers: Does the tasks in any order: `here`, `Processes` or a cluster.
        on_result: Called after each case, but not for those that were already finished.

    Raises:
        CaseFailure: For any error except CaseError, which drops the case, and StudyError, which is
            raised as it is.
        StudyError: If the system killed a process.
    """
    finished = {task.case_id: finished_result(task, stage_folder) for task in tasks}
    results = {case_id: result for case_id, result in finished.items() if result is not None}
    missing = [task for task in tasks if task.case_id not in results]
    on_progress(len(results))
    for result in workers(missing, stage_folder):
        results[result.case_id] = result
        on_result(result)
        on_progress(len(results))
    return [results[task.case_id] for task in tasks]


def finished_result(task: CaseTask, stage_folder: Path) -> CaseResult | None:
    """Return the result of an earlier run; None if there is none or its files are damaged."""
    path = stage_folder / task.case_id / CASE_FILE
    if not path.exists():
        return None
    try:
        result = _case_result.validate_json(path.read_bytes())
    except ValidationError:  # cut short or of another version: the case is done again
        return None
    if result.key != task.key or storage.not_as_written(path.parent, result.files):
        return None
    return result


def run_case(task: CaseTask, stage_folder: Path, memory_gb: float | None = None) -> CaseResult:
    """Do one task in an empty folder of its own, within the memory limit."""
    folder = stage_folder / task.case_id
    shutil.rmtree(folder, ignore_errors=True)  # left by a killed run, or by other settings
    folder.mkdir(parents=True)
    forget_peak_memory()
    start = time.perf_counter()
    row: Row = {}
    dropped = None
    try:
        with memory_capped(memory_gb):
            row = task.work(folder)
    except CaseError as error:
        dropped = error.reason
    except StudyError:  # a full disk, a damaged file of an earlier stage
        raise
    except Exception as error:
        if is_want_of_memory(error):  # the machine is too small; the case is not dropped for that
            raise StudyError(
                f"case {task.case_id}: {stage_folder.name} ran out of memory at "
                f"{peak_memory_mb() / 1024:.1f} GB"
                + (f" (--memory-gb {memory_gb:g})" if memory_gb else "")
                + ". Raise the limit, run fewer processes at a time (--jobs), or leave the case "
                "out (data.exclude); finished cases are kept."
            ) from error
        raise CaseFailure(task.case_id, traceback.format_exc()) from error
    seconds = time.perf_counter() - start
    files = storage.fingerprints(folder, files_of_case(folder))
    memory = peak_memory_mb()
    result = CaseResult(task.case_id, task.key, row, seconds, memory, dropped, files)
    storage.write_json(folder / CASE_FILE, dataclasses.asdict(result))
    return result


def here(
    tasks: Sequence[CaseTask], stage_folder: Path, memory_gb: float | None = None
) -> Iterator[CaseResult]:
    """Do one task after another in this process."""
    for task in tasks:
        yield run_case(task, stage_folder, memory_gb)

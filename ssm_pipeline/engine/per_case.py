"""Work on one case at a time, in parallel; what is finished is never done again.

A case's results lie in `<stage>/<case>/`. Its `case.json` is written last and holds the key of
everything the results depend on: present and with the same key, the case is finished.
"""

from __future__ import annotations

import dataclasses
import os
import shutil
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from ssm_pipeline import storage
from ssm_pipeline.engine import process
from ssm_pipeline.engine.left_files import CASE_FILE, files_of_case
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
    """What came of a case; `dropped` is the reason, or None where all went well."""

    case_id: str
    key: str
    row: Row = field(default_factory=dict)
    seconds: float = 0.0
    peak_memory_mb: float = 0.0
    dropped: str | None = None
    files: storage.Fingerprints = field(default_factory=dict)


_case_result = TypeAdapter(CaseResult)


class CaseFailure(RuntimeError):
    """A case broke the code: an error of ours, not of the case, with the worker's traceback."""

    def __init__(self, case_id: str, worker_traceback: str) -> None:
        last_line = worker_traceback.strip().splitlines()[-1]
        super().__init__(f"case {case_id}: {last_line}")
        self.case_id, self.worker_traceback = case_id, worker_traceback

    def __reduce__(self) -> tuple[type, tuple[str, str]]:
        return type(self), (self.case_id, self.worker_traceback)


def map_cases(
    tasks: Sequence[CaseTask],
    stage_folder: Path,
    jobs: int,
    on_progress: Callable[[int], None] = lambda done: None,
    on_result: Callable[[CaseResult], None] = lambda result: None,
) -> list[CaseResult]:
    """Do the tasks not finished yet; results in the order of the tasks.

    on_result  told of every case as it is done; not of those that were finished.
    Raises CaseFailure for any error but a CaseError, which drops its case, and a StudyError, which
    is passed on; StudyError where the system killed a process.
    """
    finished = {task.case_id: finished_result(task, stage_folder) for task in tasks}
    results = {case_id: result for case_id, result in finished.items() if result is not None}
    missing = [task for task in tasks if task.case_id not in results]
    on_progress(len(results))
    for result in _in_processes(missing, stage_folder, min(jobs, len(missing))):
        results[result.case_id] = result
        on_result(result)
        on_progress(len(results))
    return [results[task.case_id] for task in tasks]


def finished_result(task: CaseTask, stage_folder: Path) -> CaseResult | None:
    """What an earlier run made of the task; None if nothing, or if its files are not whole."""
    path = stage_folder / task.case_id / CASE_FILE
    if not path.exists():
        return None
    try:
        result = _case_result.validate_json(path.read_bytes())
    except ValidationError:  # cut short, or of another version: done again
        return None
    if result.key != task.key or storage.not_as_written(path.parent, result.files):
        return None
    return result


def run_case(task: CaseTask, stage_folder: Path) -> CaseResult:
    """Do one task in a fresh folder of its own."""
    folder = stage_folder / task.case_id
    shutil.rmtree(folder, ignore_errors=True)  # left by a killed run, or by other settings
    folder.mkdir(parents=True)
    process.forget_peak_memory()
    start = time.perf_counter()
    row: Row = {}
    dropped = None
    try:
        row = task.work(folder)
    except CaseError as error:
        dropped = error.reason
    except StudyError:  # a full disk, a damaged file of an earlier stage
        raise
    except Exception as error:
        raise CaseFailure(task.case_id, traceback.format_exc()) from error
    seconds = time.perf_counter() - start
    files = storage.fingerprints(folder, files_of_case(folder))
    memory = process.peak_memory_mb()
    result = CaseResult(task.case_id, task.key, row, seconds, memory, dropped, files)
    storage.write_json(folder / CASE_FILE, dataclasses.asdict(result))
    return result


def _run_in_worker(task: CaseTask, stage_folder: Path, parent: int) -> CaseResult:
    process.end_with_parent(parent)
    process.may_grow()
    return run_case(task, stage_folder)


def _in_processes(tasks: Sequence[CaseTask], stage_folder: Path, jobs: int) -> Iterator[CaseResult]:
    if jobs <= 1:
        for task in tasks:
            yield run_case(task, stage_folder)
        return
    import joblib
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    # One thread per process: a case per core beats many cores per case, and sums keep their order.
    with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
        parallel = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)
        try:
            work = joblib.delayed(_run_in_worker)
            yield from parallel(work(task, stage_folder, os.getpid()) for task in tasks)
        except TerminatedWorkerError as error:
            raise StudyError(
                f"a process was killed while {jobs} cases were worked on at a time, most often for "
                "want of memory. Run again with fewer (--jobs); finished cases are kept."
            ) from error

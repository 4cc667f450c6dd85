"""Processes on this machine that each work on one case."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ssm_pipeline.engine import process
from ssm_pipeline.engine.per_case import CaseResult, CaseTask, here, run_case
from ssm_pipeline.parallel import in_processes
from ssm_pipeline.records import StudyError


@dataclass(frozen=True)
class Processes:
    """`jobs` processes at a time, each with one thread and a memory limit."""

    jobs: int
    memory_gb: float | None = None

    def __call__(self, tasks: Sequence[CaseTask], stage_folder: Path) -> Iterator[CaseResult]:
        jobs = min(self.jobs, len(tasks))
        if jobs <= 1:
            return here(tasks, stage_folder, self.memory_gb)
        return self._in_processes(tasks, stage_folder, jobs)

    def _in_processes(
        self, tasks: Sequence[CaseTask], stage_folder: Path, jobs: int
    ) -> Iterator[CaseResult]:
        import joblib
        from joblib.externals.loky.process_executor import TerminatedWorkerError

        work = joblib.delayed(_run_in_worker)
        started = (work(task, stage_folder, self.memory_gb, os.getpid()) for task in tasks)
        try:  # a case per core beats many cores per case
            yield from in_processes(started, jobs, ordered=False)
        except TerminatedWorkerError as error:
            raise StudyError(
                f"the system killed a process while {jobs} processes were running, probably "
                "because memory ran out. Run again with fewer processes (--jobs); finished cases "
                "are kept."
            ) from error


def _run_in_worker(
    task: CaseTask, stage_folder: Path, memory_gb: float | None, parent: int
) -> CaseResult:
    process.end_with_parent(parent)
    process.may_grow()
    return run_case(task, stage_folder, memory_gb)

"""Process cases on the workers of a Dask cluster, also on other machines (extra `cluster`).

Only tasks and results are sent. Workers read and write the same files as this process, so every
worker must see the same folders under the same paths. A worker is refused before it starts work if
it does not see them, has other package versions, or has several threads.
"""

from __future__ import annotations

import itertools
import os
import queue
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ssm_pipeline.counting import counted
from ssm_pipeline.engine import process
from ssm_pipeline.engine.per_case import (
    CaseFailure,
    CaseResult,
    CaseTask,
    finished_result,
    run_case,
)
from ssm_pipeline.records import StudyError

if TYPE_CHECKING:  # an extra
    from distributed import Client, Future, Worker

CONNECT_S = 10.0  # time limit for connecting to the scheduler
WORKER_S = 60.0  # time limit for the first worker to appear
SHARED_S = 60.0  # a shared folder may show another machine's files with this delay
IN_FLIGHT = 1000  # tasks submitted at a time: the scheduler keeps each of them in memory


@dataclass(frozen=True)
class DaskCluster:
    """The workers of a scheduler. If a worker dies, its case is given to another worker.

    Attributes:
        wait_s: How long to wait when no worker is left. None waits without a limit, as Slurm's
            queue may be long.
    """

    client: Client
    memory_gb: float | None = None
    wait_s: float | None = WORKER_S
    say: Callable[[str], None] = lambda line: None

    def __call__(self, tasks: Sequence[CaseTask], stage_folder: Path) -> Iterator[CaseResult]:
        stage_folder.mkdir(parents=True, exist_ok=True)  # workers check that they see it
        self._await_the_end_of(stage_folder)
        here, token = Here(Path.cwd(), process.versions()), uuid.uuid4().hex
        waiting, sent = iter(tasks), {}
        done: queue.Queue[Future[CaseResult]] = queue.Queue()

        def send(count: int) -> None:
            for task in itertools.islice(waiting, count):
                key = f"{stage_folder.resolve()}/{task.case_id} {token}"
                sent[key] = (task, self._sent(key, task, stage_folder, here))
                sent[key][1].add_done_callback(done.put)

        send(IN_FLIGHT)
        while sent:
            future = self._next(done)
            task, _ = sent.pop(str(future.key))
            send(1)
            yield _result(future, task, stage_folder)

    def _sent(self, key: str, task: CaseTask, stage_folder: Path, here: Here) -> Future[CaseResult]:
        return self.client.submit(
            _on_worker, task, stage_folder, here, self.memory_gb, key=key, pure=False
        )

    def _next(self, done: queue.Queue[Future[CaseResult]]) -> Future[CaseResult]:
        alone_since = None
        while True:
            try:
                return done.get(timeout=1)
            except queue.Empty:
                now = time.monotonic()
                if self.client.scheduler_info()["workers"]:
                    alone_since = None
                else:
                    alone_since = alone_since or now
                    if self.wait_s is not None and now - alone_since > self.wait_s:
                        raise StudyError(
                            "the cluster has no workers left. Start workers, then run the same "
                            "command again; finished cases are kept."
                        ) from None

    def _await_the_end_of(self, stage_folder: Path) -> None:
        """Wait until no task of an earlier, killed run still writes to this folder."""
        is_said = False
        while left := self._at_work_in(stage_folder):
            if not is_said:
                self.say(f"waiting for {counted(left, 'case')} that an earlier run still processes")
            is_said = True
            time.sleep(1)

    def _at_work_in(self, stage_folder: Path) -> int:
        counts = self.client.run(_count_at_work, f"{stage_folder.resolve()}/", on_error="return")
        for worker, found in counts.items():
            # A worker that dies at this moment raises OSError. Other errors mean that the worker
            # can't import the program; it would end without a message later.
            if isinstance(found, Exception) and not isinstance(found, OSError):
                raise StudyError(
                    f"the worker {worker} can't import ssm_pipeline: {found}. Install the same "
                    "version of ssm-pipeline[cluster] there."
                )
        return sum(found for found in counts.values() if isinstance(found, int))


@contextmanager
def connected(address: str) -> Iterator[Client]:
    """Yield a client of the scheduler at `tcp://host:port`.

    Raises:
        StudyError: If no scheduler answers there, or if it has no worker.
    """
    Client = dask().Client
    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise StudyError(
            f"--cluster {address}: no Dask scheduler answers there ({str(error).splitlines()[0]}). "
            "Start one with `dask scheduler`; it prints its address."
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=WORKER_S)
        except TimeoutError as error:
            raise StudyError(
                f"--cluster {address}: the scheduler has no workers. Start some with: dask worker "
                f"{address} --nworkers 8 --nthreads 1"
            ) from error
        yield client


def dask() -> Any:
    try:
        import distributed
    except ImportError as error:
        raise StudyError(
            "--cluster needs the extra `cluster`, here and on the workers. Install it with: "
            "pip install 'ssm-pipeline[cluster]'"
        ) from error
    return distributed


@dataclass(frozen=True)
class Here:
    """What a worker must have in common with this process."""

    folder: Path
    versions: Mapping[str, str]


def _on_worker(
    task: CaseTask, stage_folder: Path, there: Here, memory_gb: float | None
) -> CaseResult:
    from distributed import get_worker

    _refuse_unlike(get_worker(), there, stage_folder)
    return run_case(task, stage_folder, memory_gb)


def _refuse_unlike(worker: Worker, there: Here, stage_folder: Path) -> None:
    named = f"the worker {worker.address}"
    if worker.state.nthreads != 1 or not process.holds_one_thread():
        raise StudyError(
            f"{named} has {counted(worker.state.nthreads, 'thread')} and OMP_NUM_THREADS="
            f"{os.environ.get('OMP_NUM_THREADS', '')}. It must have 1 thread and "
            "OMP_NUM_THREADS=1, or results differ between workers. Start it with: "
            "OMP_NUM_THREADS=1 dask worker ADDRESS --nworkers 8 --nthreads 1"
        )
    ours = process.versions()
    other = [name for name in there.versions if ours.get(name) != there.versions[name]]
    if unlike := [name for name in other if name != "platform"]:
        listed = ", ".join(f"{n} {ours.get(n, '(not installed)')}" for n in unlike)
        wanted = ", ".join(f"{name} {there.versions[name]}" for name in unlike)
        raise StudyError(
            f"{named} has {listed}; this run has {wanted}. Install the same versions there."
        )
    try:
        os.chdir(there.folder)  # the run's paths may be relative
        seen = stage_folder.is_dir()
    except OSError:
        seen = False
    if not seen:
        raise StudyError(
            f"{named} does not see {there.folder / stage_folder}. The runs folder, the data and "
            "the working directory must be shared with all workers under the same paths."
        )


def _count_at_work(prefix: str, dask_worker: Worker) -> int:
    return sum(str(task.key).startswith(prefix) for task in dask_worker.state.executing)


def _result(future: Future[CaseResult], task: CaseTask, stage_folder: Path) -> CaseResult:
    """Return the worker's result once its files are visible here, or raise the worker's error."""
    from distributed import CancelledError, KilledWorker

    again = "Then run the same command again; finished cases are kept."
    try:
        result = future.result()
    except (StudyError, CaseFailure):
        raise
    except KilledWorker as error:
        raise StudyError(
            f"case {task.case_id}: every worker that processed it died, probably because it ran "
            "out of memory. Give the workers more memory, or leave the case out (data.exclude). "
            + again
        ) from error
    except CancelledError as error:
        raise StudyError(
            f"the scheduler has stopped or cancelled the work. Start it again. {again}"
        ) from error
    except Exception as error:
        raise StudyError(
            f"case {task.case_id}: a worker could not process it ({type(error).__name__}: "
            f"{error}). Install the same version of ssm-pipeline[cluster] on all workers."
        ) from error
    until = time.monotonic() + SHARED_S
    while finished_result(task, stage_folder) is None:
        if time.monotonic() > until:
            raise StudyError(
                f"case {task.case_id}: a worker has finished it, but its files do not appear in "
                f"{stage_folder / task.case_id}. Put the runs folder on a disk that all machines "
                "share."
            )
        time.sleep(0.5)
        [*stage_folder.iterdir()]  # makes a network file system look again
    returned: CaseResult = result
    return returned

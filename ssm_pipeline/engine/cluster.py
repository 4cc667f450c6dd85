"""Cases worked on by the workers of a Dask cluster, on other machines too (extra `cluster`).

Only tasks and results travel: the files are read and written where this process reads and writes
them, so every worker must see the same folders by the same names. A worker that does not, that
has other versions or several threads is refused before it works on anything.
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

CONNECT_S = 10.0  # a scheduler that does not answer for so long is not there
WORKER_S = 60.0  # a scheduler without a worker is given so long
SHARED_S = 60.0  # a shared folder may show another machine's files this late
IN_FLIGHT = 1000  # tasks with the scheduler at a time: it keeps all of each in memory


@dataclass(frozen=True)
class DaskCluster:
    """The workers of a scheduler. A case whose worker dies is given to another.

    Attributes:
        wait_s: How long to wait for a worker where none is left; None: for ever, as for Slurm's
            queue.
    """

    client: Client
    memory_gb: float | None = None
    wait_s: float | None = WORKER_S
    say: Callable[[str], None] = lambda line: None

    def __call__(self, tasks: Sequence[CaseTask], stage_folder: Path) -> Iterator[CaseResult]:
        stage_folder.mkdir(parents=True, exist_ok=True)  # by which a worker knows the place
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
                            "the cluster has no worker left. Start some, and run the same command "
                            "again: finished cases are kept."
                        ) from None

    def _await_the_end_of(self, stage_folder: Path) -> None:
        """Of what a killed run left at work in this folder: it would write beside this run."""
        is_said = False
        while left := self._at_work_in(stage_folder):
            if not is_said:
                self.say(f"waiting for {counted(left, 'case')} that an earlier run left at work")
            is_said = True
            time.sleep(1)

    def _at_work_in(self, stage_folder: Path) -> int:
        counts = self.client.run(_count_at_work, f"{stage_folder.resolve()}/", on_error="return")
        for worker, found in counts.items():
            # One that dies just now is an OSError. What it can't load would end it without a word.
            if isinstance(found, Exception) and not isinstance(found, OSError):
                raise StudyError(
                    f"the worker {worker} can't load the program: {found}. Install the same "
                    "ssm-pipeline[cluster] there."
                )
        return sum(found for found in counts.values() if isinstance(found, int))


@contextmanager
def connected(address: str) -> Iterator[Client]:
    """A client of the scheduler at `tcp://host:port`.

    Raises:
        StudyError: If none answers there, or if it has no worker.
    """
    Client = dask().Client
    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise StudyError(
            f"--cluster {address}: no Dask scheduler answers there ({str(error).splitlines()[0]}). "
            "Start one with: dask scheduler. It says its address."
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=WORKER_S)
        except TimeoutError as error:
            raise StudyError(
                f"--cluster {address}: the scheduler has no worker. Start some with: dask worker "
                f"{address} --nworkers 8 --nthreads 1"
            ) from error
        yield client


def dask() -> Any:
    try:
        import distributed
    except ImportError as error:
        raise StudyError(
            "--cluster needs the extra cluster, here and on the workers: "
            "pip install 'ssm-pipeline[cluster]'."
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
            f"{named} has {worker.state.nthreads} threads, and OMP_NUM_THREADS="
            f"{os.environ.get('OMP_NUM_THREADS', '')}; one is needed, and 1, or results are not "
            "the same everywhere. Start it with: dask worker ADDRESS --nworkers 8 --nthreads 1"
        )
    ours = process.versions()
    other = [name for name in there.versions if ours.get(name) != there.versions[name]]
    if unlike := [name for name in other if name != "platform"]:
        listed = ", ".join(f"{n} {ours.get(n, 'not at all')}" for n in unlike)
        wanted = ", ".join(f"{name} {there.versions[name]}" for name in unlike)
        raise StudyError(f"{named} has {listed}; this run has {wanted}. Install the same there.")
    try:
        os.chdir(there.folder)  # paths that the run was given may be relative
        seen = stage_folder.is_dir()
    except OSError:
        seen = False
    if not seen:
        raise StudyError(
            f"{named} does not see {there.folder / stage_folder}. The runs folder, the data and "
            "the folder that the run is started in must be shared, under the same names."
        )


def _count_at_work(prefix: str, dask_worker: Worker) -> int:
    return sum(str(task.key).startswith(prefix) for task in dask_worker.state.executing)


def _result(future: Future[CaseResult], task: CaseTask, stage_folder: Path) -> CaseResult:
    """What the worker says, once its files are seen here. Raises what it raised."""
    from distributed import CancelledError, KilledWorker

    again = "Run the same command again: finished cases are kept."
    try:
        result = future.result()
    except (StudyError, CaseFailure):
        raise
    except KilledWorker as error:
        raise StudyError(
            f"case {task.case_id} ended every worker it was given to, most often for want of "
            "memory. Give the workers more, or leave the case out (data.exclude). " + again
        ) from error
    except CancelledError as error:
        raise StudyError(f"the scheduler is gone, or gave the work up. {again}") from error
    except Exception as error:
        raise StudyError(
            f"a worker can't take case {task.case_id} ({type(error).__name__}: {error}). "
            "ssm-pipeline[cluster] must be installed there as it is here."
        ) from error
    until = time.monotonic() + SHARED_S
    while finished_result(task, stage_folder) is None:
        if time.monotonic() > until:
            raise StudyError(
                f"a worker has finished case {task.case_id}, and {stage_folder / task.case_id} "
                "does not show it: the runs folder is not shared. Put it where all machines see it."
            )
        time.sleep(0.5)
        [*stage_folder.iterdir()]  # makes a network file system look again
    returned: CaseResult = result
    return returned

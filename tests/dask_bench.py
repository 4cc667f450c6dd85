"""A Dask scheduler and workers on this machine, in processes of their own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[1]
PATHS = os.pathsep.join(map(str, (ROOT, ROOT / "tests", ROOT / "tests" / "engine")))


class DaskBench:
    """Started with `with`; all of it is ended with the block."""

    def __init__(self, folder: Path, workers: int = 2) -> None:
        self.folder, self.count = folder, workers
        self.workers: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> DaskBench:
        place = self.folder / "scheduler.json"
        self.scheduler = self._start("scheduler", "--host", "127.0.0.1", "--port", "0")
        self.address = json.loads(_when_written(place))["address"]
        self.workers = [self.add_worker() for _ in range(self.count)]
        return self

    def __exit__(self, *error: object) -> None:
        for process in [*self.workers, self.scheduler]:
            self.kill(process)

    def add_worker(self, threads: int = 1, paths: str = PATHS) -> subprocess.Popen[bytes]:
        words = ("--local-directory", str(self.folder), "--nthreads", str(threads))
        return self._start("worker", *words, paths=paths)

    def kill(self, process: subprocess.Popen[bytes]) -> None:
        """The process and those it started, its nanny's worker among them, at once."""
        try:
            os.killpg(process.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
        process.wait()

    @contextmanager
    def killed_when(
        self, process: subprocess.Popen[bytes], is_time: Callable[[], bool]
    ) -> Iterator[None]:
        """The block goes on beside it, and ends no earlier than the process."""

        def kill() -> None:
            while not is_time():
                time.sleep(0.05)
            self.kill(process)

        killer = threading.Thread(target=kill, daemon=True)
        killer.start()
        yield
        killer.join()

    def _start(self, kind: str, *words: str, paths: str = PATHS) -> subprocess.Popen[bytes]:
        place = ["--scheduler-file", str(self.folder / "scheduler.json"), "--no-dashboard"]
        module = f"distributed.cli.dask_{kind}"
        with (self.folder / "dask.log").open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-m", module, *place, *words],
                env={**os.environ, "PYTHONPATH": paths},
                cwd=self.folder,
                start_new_session=True,
                stdout=log,
                stderr=log,
            )


def _when_written(path: Path) -> str:
    until = time.monotonic() + 120
    while not (path.exists() and path.read_text(encoding="utf-8").endswith("}")):
        assert time.monotonic() < until, f"no {path}"
        time.sleep(0.1)
    return path.read_text(encoding="utf-8")

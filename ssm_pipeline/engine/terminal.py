"""The messages of a run: a line per stage, progress of long work, dropped cases, the report."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeRemainingColumn,
)

from ssm_pipeline.counting import counted
from ssm_pipeline.engine.run_log import RunLog
from ssm_pipeline.records import Dropped

SHOWN_DROPPED = 20
PLAIN_INTERVAL_S = 30.0  # where there is no terminal, a progress line this often
INDENT = " " * 6  # of the lines below that of a stage, whose name follows "[3/8] "
LOG_INTERVAL_S = 5.0  # for `workflow status`


class Steps:
    """Count the finished steps of one piece of work, on a bar or as lines in a log."""

    def __init__(
        self,
        console: Console,
        label: str,
        total: int,
        bar: Progress | None,
        log: Callable[..., None] = lambda kind, **what: None,
    ) -> None:
        self.console, self.label, self.total, self.bar, self.log = console, label, total, bar, log
        self.done, self.said = 0, time.monotonic()
        self.logged = 0.0
        self.task = bar.add_task(label, total=total, note="") if bar else None

    def advance_to(self, done: int, note: str = "") -> None:
        self.done = done
        if time.monotonic() - self.logged >= LOG_INTERVAL_S or done == self.total:
            self.logged = time.monotonic()
            self.log("progress", label=self.label, done=done, total=self.total)
        if self.bar is not None and self.task is not None:
            self.bar.update(self.task, completed=done, note=note)
        elif self.total > 1 and time.monotonic() - self.said >= PLAIN_INTERVAL_S:
            self.said = time.monotonic()
            self.console.print(f"{INDENT}{self.label} {done} of {self.total}   {note}".rstrip())


class Terminal:
    """Print progress bars on a terminal, and plain lines elsewhere.

    Inside `logged_to` all messages are also written to the run's log.
    """

    def __init__(self, console: Console | None = None) -> None:
        self.console = console or Console(highlight=False, soft_wrap=True, markup=False)
        self._log: RunLog | None = None

    def say(self, line: str) -> None:
        self.console.print(line)
        if self._log is not None:
            self._log.say(line)

    def detail(self, line: str) -> None:
        """Print a line below that of its stage."""
        self.say(INDENT + line)

    def log(self, kind: str, **what: Any) -> None:
        """Write an event to the run's log; nothing is printed."""
        if self._log is not None:
            self._log.event(kind, **what)

    @contextmanager
    def logged_to(self, run_folder: Path) -> Iterator[RunLog]:
        self._log, before = RunLog(run_folder), self._log
        try:
            yield self._log
        finally:
            self._log = before

    @contextmanager
    def steps(self, label: str, total: int) -> Iterator[Steps]:
        if not self.console.is_terminal:
            yield Steps(self.console, label, total, None, self.log)
            return
        columns = (
            TextColumn(INDENT + "{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[note]}"),
        )
        with Progress(*columns, console=self.console, transient=True) as bar:
            yield Steps(self.console, label, total, bar, self.log)

    def stage(
        self, number: int, total: int, name: str, result: str, dropped: Sequence[Dropped]
    ) -> None:
        self.say(f"[{number}/{total}] {name:<15}{result}")
        self._details([f"dropped {case.case_id}: {case.reason}" for case in dropped])

    def left_out(self, dropped: Sequence[Dropped]) -> None:
        """List, at the end of a run, the cases that were left out of the model."""
        self.say(f"{counted(len(dropped), 'case was', 'cases were')} left out:")
        self._details([f"{case.case_id} ({case.stage}): {case.reason}" for case in dropped])

    def _details(self, lines: Sequence[str]) -> None:
        for line in lines[:SHOWN_DROPPED]:
            self.detail(line)
        if len(lines) > SHOWN_DROPPED:
            self.detail(f"and {len(lines) - SHOWN_DROPPED} more; stage.json names them all")


def duration(seconds: float) -> str:
    """`0.4 s`, `12 s`, `4 min 10 s`, `2 h 5 min`."""
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"

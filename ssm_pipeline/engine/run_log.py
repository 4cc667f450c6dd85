"""The logs in a run's folder: `run.log` for people, `run.jsonl` for programs."""

from __future__ import annotations

import datetime
import json
import os
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from ssm_pipeline.records import CaseError, StudyError

TEXT_LOG, EVENT_LOG = "run.log", "run.jsonl"


class RunLog:
    """Append to the two logs of a run's folder; each line is written at once."""

    def __init__(self, run_folder: Path) -> None:
        self.text, self.events = run_folder / TEXT_LOG, run_folder / EVENT_LOG
        for path in (self.text, self.events):
            _end_last_line(path)

    def say(self, text: str) -> None:
        with self.text.open("a", encoding="utf-8") as file:
            file.write(f"{_now()}  {text}\n")

    def event(self, kind: str, **what: Any) -> None:
        line = json.dumps({"time": _now(), "event": kind, **what})
        with self.events.open("a", encoding="utf-8") as file:
            file.write(line + "\n")

    @contextmanager
    def kept_errors(self) -> Iterator[None]:
        """Log the traceback of any error in the block; faults of the program name the log file."""
        try:
            yield
        except BaseException as error:
            with suppress(OSError):  # if the disk is full, the error itself reports that
                self.event("run stopped", error=f"{type(error).__name__}: {error}")
                self.say("".join(traceback.format_exception(error)).rstrip())
            if not isinstance(error, CaseError | StudyError | KeyboardInterrupt):
                error.add_note(f"The traceback is in {self.text}.")
            raise


def read_events(run_folder: Path) -> Iterator[dict[str, Any]]:
    """Yield the events of a run, the oldest first. Incomplete lines are skipped.

    Each event has "event" (str) and "time" (datetime, with its zone).
    """
    path = run_folder / EVENT_LOG
    if not path.is_file():
        return
    with path.open(encoding="utf-8", errors="replace") as file:
        for line in file:
            try:
                event = json.loads(line)
                when = datetime.datetime.fromisoformat(event["time"])
                if when.tzinfo is not None:
                    yield {**event, "event": str(event["event"]), "time": when}
            except (ValueError, KeyError, TypeError, RecursionError):
                continue


def _end_last_line(path: Path) -> None:
    """End a line that a power cut left incomplete, so that it stays a separate line."""
    if not path.is_file() or not path.stat().st_size:
        return
    with path.open("rb+") as file:
        file.seek(-1, os.SEEK_END)
        if file.read(1) != b"\n":
            file.write(b"\n")


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")

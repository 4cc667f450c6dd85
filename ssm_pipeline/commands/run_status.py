"""`workflow status`: where a run stands, from what it left and from its log."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ssm_pipeline.engine.ownership import alone_in
from ssm_pipeline.engine.run_log import read_events
from ssm_pipeline.engine.stage import StageRecord
from ssm_pipeline.engine.terminal import duration
from ssm_pipeline.records import StudyError


@dataclass(frozen=True)
class Work:
    """What a run is, or was, in the middle of.

    stage; label, done, total: its piece of work; dropped: cases so far; since, seen: when it
    began, and was last heard of.
    """

    stage: str
    label: str
    done: int
    total: int
    dropped: int
    since: datetime.datetime
    seen: datetime.datetime

    @property
    def seconds_left(self) -> float | None:
        """Of this piece of work, at the pace so far; None where there is no pace yet."""
        spent = (self.seen - self.since).total_seconds()
        if not self.done or not spent:
            return None
        return spent / self.done * (self.total - self.done)


def status_lines(run_folder: Path) -> list[str]:
    """A line a stage, what runs now and how long still. Raises StudyError without a run.

    A stage that runs is judged by its pace so far; the stages after it are not foreseen.
    """
    records = [StageRecord.read(path.parent) for path in run_folder.glob("*/stage.json")]
    finished = sorted((r for r in records if r is not None), key=lambda r: r.finished_at)
    events = list(read_events(run_folder))
    if not finished and not events:
        raise StudyError(f"{run_folder} holds no run; give a folder such as runs/luna16.")
    lines = [f"{'stage':<16}{'cases':>7}{'dropped':>9}{'time':>14}{'memory':>10}"]
    for record in finished:
        lines.append(
            f"{record.stage:<16}{len(record.cases_out):>7}{len(record.dropped):>9}"
            f"{duration(record.seconds):>14}{record.peak_memory_mb:>7.0f} MB"
        )
    work = work_in_hand(events)
    if _is_running(run_folder):
        lines.append(f"now: {_described(work)}" if work else "now: starting")
    elif work is not None:
        lines.append(f"stopped: {_described(work)}. The same command goes on from there.")
        if events and events[-1]["event"] == "run stopped":
            lines.append(f"because: {str(events[-1].get('error', '')).splitlines()[0]}")
    else:
        lines.append("finished")
    return lines


def work_in_hand(events: list[dict[str, Any]]) -> Work | None:
    """What the last run's last unfinished stage is at; None if it came to its end."""
    work: Work | None = None
    for event in events:
        when = datetime.datetime.fromisoformat(event["time"])
        kind = event["event"]
        if kind in ("run", "stage finished", "run finished"):
            work = None
        elif kind == "stage started":
            work = Work(event["stage"], event["stage"], 0, event["cases"], 0, when, when)
        elif kind == "progress" and work is not None:
            since = work.since if event["label"] == work.label else when
            label, done, total = event["label"], event["done"], event["total"]
            work = Work(work.stage, label, done, total, work.dropped, since, when)
        elif kind == "case" and work is not None and event["dropped"]:
            parts = vars(work) | {"dropped": work.dropped + 1}
            work = Work(**parts)
    return work


def _described(work: Work) -> str:
    what = work.stage if work.label == work.stage else f"{work.stage}, {work.label}"
    text = f"{what} {work.done} of {work.total}"
    if work.dropped:
        text += f", {work.dropped} dropped"
    left = work.seconds_left
    return text if left is None else f"{text}, about {duration(left)} to go"


def _is_running(run_folder: Path) -> bool:
    try:
        with alone_in(run_folder):
            return False
    except StudyError:
        return True

"""`workflow status`: show the progress of a run, from its files and its log."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ssm_pipeline.commands.time_left import (
    Event,
    Took,
    expected_seconds,
    planned_stages,
    stages_that_ended,
    whole_number,
)
from ssm_pipeline.engine.ownership import alone_in
from ssm_pipeline.engine.run_log import read_events
from ssm_pipeline.engine.stage import StageRecord
from ssm_pipeline.engine.terminal import duration
from ssm_pipeline.records import StudyError
from ssm_pipeline.runs.former_results import former_results


@dataclass(frozen=True)
class Work:
    """The unfinished work of a run.

    stage, cases; label, done, total: its piece of work; dropped: cases so far; stage_began, began,
    seen: when the stage and its piece began, and when the run was last heard of.
    """

    stage: str
    cases: int
    label: str
    done: int
    total: int
    dropped: int
    stage_began: datetime.datetime
    began: datetime.datetime
    seen: datetime.datetime

    @property
    def seconds_left(self) -> float | None:
        """Estimated seconds left of this piece of work; None before its first step."""
        spent = (self.seen - self.began).total_seconds()
        if self.done <= 0 or spent <= 0:
            return None
        return spent / self.done * max(self.total - self.done, 0)


def status_lines(run_folder: Path) -> list[str]:
    """Return a line per stage, the current work, and the estimated time left.

    Raises:
        StudyError: If the folder holds no run.
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
        lines.append(f"stopped: {_described(work)}. Run the same command again to continue.")
        if events and events[-1]["event"] == "run stopped":
            because = str(events[-1].get("error", "")).splitlines()
            lines.append(f"because: {because[0] if because else 'the log gives no reason'}")
    elif finished:
        lines += ["finished", *former_results(run_folder)]
    else:  # its stages were deleted, as by `workflow forget`
        lines = ["no stage is finished. Run the study again: workflow run"]
    if work is not None:
        lines += lines_of_time_left(work, events, stages_that_ended(run_folder.parent))
    return lines


def work_in_hand(events: Sequence[Event]) -> Work | None:
    """Return the work of the last unfinished stage; None if the last run finished."""
    work: Work | None = None
    for event in events:
        kind, when = event["event"], event["time"]
        if kind in ("run", "stage finished", "run finished"):
            work = None
        elif kind == "stage started":
            stage, cases = str(event.get("stage")), whole_number(event, "cases")
            work = Work(stage, cases, stage, 0, cases, 0, when, when, when)
        elif kind == "progress" and work is not None:
            label = str(event.get("label"))
            work = replace(
                work,
                label=label,
                done=whole_number(event, "done"),
                total=whole_number(event, "total"),
                began=work.began if label == work.label else when,
                seen=when,
            )
        elif kind == "case" and work is not None and event.get("dropped"):
            work = replace(work, dropped=work.dropped + 1)
    return work


def lines_of_time_left(work: Work, events: Sequence[Event], took: Sequence[Took]) -> list[str]:
    """Return lines with the estimated time left, its basis, and what is unknown.

    Args:
        took: Earlier times of stages, in this run and in others.
    """
    plan = planned_stages(events)
    names = [planned.stage for planned in plan]
    if work.stage not in names:
        return [f"in all: unknown; the log does not list the stages after {work.stage}"]
    here = names.index(work.stage)
    as_before = expected_seconds(plan[here], work.cases, took)
    left = [(work.stage, _of_the_stage_at_hand(work, as_before))]
    left += [(one.stage, expected_seconds(one, work.cases, took)) for one in plan[here + 1 :]]
    known = [(stage, seconds) for stage, seconds in left if seconds is not None]
    unknown = [stage for stage, seconds in left if seconds is None]
    lines = []
    later = [f"{stage} {duration(seconds)}" for stage, seconds in known if stage != work.stage]
    if later:
        lines.append(f"then: {', '.join(later)}, estimated from earlier runs")
    total = duration(sum(seconds for _, seconds in known))
    if as_before is not None and not unknown:
        lines.append(f"in all: about {total} to go")
    else:
        lines.append(f"in all: at least {total} to go" if known else "in all: unknown")
    if unknown:
        lines.append(
            f"unknown: the time of {', '.join(unknown)}; no run in this folder has finished "
            "this with these settings"
        )
    return lines


def _of_the_stage_at_hand(work: Work, as_before: float | None) -> float | None:
    """Return the longer of two estimates: from the current pace, and from the stage's last time.

    The pace alone is too short if the stage has further pieces of work.
    """
    if as_before is None:
        return work.seconds_left
    rest = as_before - (work.seen - work.stage_began).total_seconds()
    return max(rest, work.seconds_left or 0.0)


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

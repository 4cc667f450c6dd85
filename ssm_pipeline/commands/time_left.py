"""How long a run's stages will take: by what like stages took before, in any run of the folder.

The log of a run names its stages in order, and gives each a mark, `like`: stages of one mark do
the same by the same settings, with as many processes on the same device.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ssm_pipeline.engine.run_log import EVENT_LOG, read_events

Event = dict[str, Any]


@dataclass(frozen=True)
class Planned:
    """A stage of a run; per_case: its time grows with the cases."""

    stage: str
    like: str
    per_case: bool


@dataclass(frozen=True)
class Took:
    """The seconds that a stage once took, all its sessions together, for so many cases."""

    like: str
    cases: int
    seconds: float


def planned_stages(events: Iterable[Event]) -> tuple[Planned, ...]:
    """The stages of the last run in these events; none where its log does not name them."""
    plan: tuple[Planned, ...] = ()
    for event in events:
        if event["event"] == "run":
            try:
                plan = tuple(
                    Planned(str(one["stage"]), str(one["like"]), bool(one["per_case"]))
                    for one in event["stages"]
                )
            except (KeyError, TypeError):
                plan = ()
    return plan


def expected_seconds(planned: Planned, cases: int, took: Sequence[Took]) -> float | None:
    """By the like stage whose cases were nearest in number, the latest of such; None without one.

    >>> expected_seconds(Planned("meshing", "a", True), 30, [Took("a", 10, 5.0)])
    15.0
    """
    alike = [one for one in took if one.like == planned.like]
    if not alike:
        return None
    nearest = min(reversed(alike), key=lambda one: abs(one.cases - cases))
    return nearest.seconds * (cases / nearest.cases if planned.per_case else 1.0)


def stages_that_ended(runs: Path) -> list[Took]:
    """What stages took in all runs of a folder, by their logs."""
    logs = sorted(runs.glob(f"*/{EVENT_LOG}"))
    return [took for log in logs for took in stages_that_ended_in(read_events(log.parent))]


def stages_that_ended_in(events: Iterable[Event]) -> list[Took]:
    """One per stage and time that it ended: its cases are those that were worked on since the last.

    What a killed run spent on a stage counts until its last event.
    """
    found: list[Took] = []
    marks: dict[str, str] = {}
    seconds: dict[str, float] = {}
    worked_on: dict[str, set[str]] = {}
    mark, given, last = "", 0, None
    for event in events:
        kind = event["event"]
        if mark and last is not None and kind != "run":
            seconds[mark] += (event["time"] - last).total_seconds()
        last = event["time"]
        if kind == "run":
            marks, mark = {one.stage: one.like for one in planned_stages([event])}, ""
        elif kind == "stage started":
            mark, given = marks.get(str(event.get("stage")), ""), whole_number(event, "cases")
            seconds.setdefault(mark, 0.0)
            worked_on.setdefault(mark, set())
        elif kind == "case" and mark:
            worked_on[mark].add(str(event.get("case_id")))
        elif kind == "stage finished" and mark:
            if cases := len(worked_on.pop(mark)) or given:
                found.append(Took(mark, cases, seconds.pop(mark)))
            mark = ""
    return found


def whole_number(event: Event, name: str) -> int:
    """0 where a damaged log has none."""
    value = event.get(name)
    return value if isinstance(value, int) else 0

"""A stage, its inputs, its outcome, and the `stage.json` that records it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import pandas as pd
from pydantic import TypeAdapter, ValidationError

from ssm_pipeline import storage
from ssm_pipeline.engine.keys import key_of
from ssm_pipeline.engine.left_files import STAGE_FILE
from ssm_pipeline.engine.per_case import CaseResult, CaseTask, Row, Workers, here, map_cases
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.records import Cohort, Dropped


class JobSettings(Protocol):
    """The part of a study's settings that the engine uses."""

    @property
    def seed(self) -> int: ...

    def to_yaml(self) -> str: ...


S = TypeVar("S", bound=JobSettings)


@dataclass(frozen=True)
class Outcome:
    """The result of a stage: the cases it kept, each with the key of its results."""

    case_keys: Mapping[str, str]
    dropped: tuple[Dropped, ...] = ()
    peak_memory_mb: float = 0.0
    note: str = ""


@dataclass(frozen=True)
class Stage(Generic[S]):
    """One step of the pipeline.

    Attributes:
        settings: The part of the settings that its result depends on.
        needs: The stages whose results it reads; empty if it reads the masks.
        version: Raise it when the stage's results change for the same input.
        per_case: Whether its time grows with the number of cases; that of training does not.
    """

    name: str
    work: Callable[[StageContext[S]], Outcome]
    settings: Callable[[S], Any]
    needs: tuple[str, ...] = ()
    version: int = 1
    per_case: bool = True


@dataclass(frozen=True)
class StageRecord:
    """The content of `stage.json`."""

    stage: str
    key: str
    settings: Any
    seed: int
    inputs: dict[str, str]
    versions: dict[str, str]
    finished_at: str
    seconds: float
    peak_memory_mb: float
    cases_in: list[str]
    cases_out: list[str]
    dropped: list[dict[str, str]]
    case_keys: dict[str, str]
    note: str = ""
    ran_on: dict[str, Any] = field(default_factory=dict)  # what may change the last bits
    files: storage.Fingerprints = field(default_factory=dict)

    def write(self, folder: Path) -> None:
        storage.write_json(folder / STAGE_FILE, dataclasses.asdict(self))

    @staticmethod
    def read(folder: Path) -> StageRecord | None:
        """Read a stage's record; None if the stage is not finished or the record is unreadable."""
        path = folder / STAGE_FILE
        try:
            return _stage_record.validate_json(path.read_bytes())
        except (FileNotFoundError, ValidationError):
            return None


_stage_record = TypeAdapter(StageRecord)


@dataclass(frozen=True)
class StageContext(Generic[S]):
    """The inputs of a stage's work.

    Attributes:
        workers: Processes the cases.
        jobs: Number of processes for work on all cases together.
    """

    name: str
    key: str
    study: str
    run_folder: Path
    settings: S
    device: str
    jobs: int
    terminal: Terminal
    cohort: Cohort
    done: Mapping[str, StageRecord]
    workers: Workers
    case_keys: Mapping[str, str] = field(default_factory=dict)
    needs: tuple[str, ...] = ()

    @property
    def seed(self) -> int:
        return self.settings.seed

    @property
    def readable(self) -> frozenset[str]:
        """The stages whose files this one may read; the key depends only on these."""
        return frozenset((*self.needs, self.name))

    def folder(self) -> Path:
        return self.run_folder / self.name

    def case_key(self, case_id: str, *parts: Any) -> str:
        """Return the key of this stage's results for a case: the case's key and `parts`."""
        return key_of(self.name, self.case_keys[case_id], *parts)

    def key_of(self, *parts: Any) -> str:
        """Return the key of a result that depends on all cases and on `parts`."""
        return key_of(self.name, dict(self.case_keys), *parts)

    def map_cases(
        self, tasks: Sequence[CaseTask], folder: Path | None = None, in_this_process: bool = False
    ) -> list[CaseResult]:
        """Do the tasks that are not finished, in this stage's folder or in one inside it.

        Args:
            in_this_process: For work on all cases together, which starts its own processes.
        """
        place = folder or self.folder()
        workers = here if in_this_process else self.workers
        with self.terminal.steps(place.name, len(tasks)) as steps:
            return map_cases(tasks, place, workers, steps.advance_to, self._log_case)

    def _log_case(self, result: CaseResult) -> None:
        self.terminal.log(
            "case",
            stage=self.name,
            case_id=result.case_id,
            seconds=round(result.seconds, 3),
            peak_memory_mb=round(result.peak_memory_mb, 1),
            dropped=result.dropped,
        )

    def write_table(self, name: str, rows: Sequence[Row]) -> None:
        storage.write_table(pd.DataFrame(list(rows)), self.folder() / f"{name}.csv")

    def outcome(self, results: Sequence[CaseResult], note: str = "") -> Outcome:
        return Outcome(
            {result.case_id: result.key for result in results if result.dropped is None},
            tuple(
                Dropped(result.case_id, self.name, result.dropped)
                for result in results
                if result.dropped is not None
            ),
            max((result.peak_memory_mb for result in results), default=0.0),
            note,
        )

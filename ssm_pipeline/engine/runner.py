"""Run the stages of a study: each only if something that it depends on has changed."""

from __future__ import annotations

import datetime
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ssm_pipeline import storage
from ssm_pipeline.counting import counted
from ssm_pipeline.engine import process
from ssm_pipeline.engine.keys import key_of
from ssm_pipeline.engine.left_files import STAGE_FILE, damaged_files, files_of_stage, undo
from ssm_pipeline.engine.memory import forget_peak_memory, peak_memory_mb
from ssm_pipeline.engine.ownership import alone_in, make_room, take
from ssm_pipeline.engine.per_case import Workers
from ssm_pipeline.engine.stage import JobSettings, Outcome, Stage, StageContext, StageRecord
from ssm_pipeline.engine.terminal import Terminal, duration
from ssm_pipeline.engine.withdrawn import without_withdrawn
from ssm_pipeline.engine.workers import Processes
from ssm_pipeline.records import Cohort, DamagedFile, Dropped, StudyError

FEWEST_CASES = 4  # one is left out to score the model, and a model needs three


@dataclass(frozen=True)
class Job:
    """A study as the engine sees it.

    Attributes:
        name: The name of the study and of its folder in the runs folder.
        data: Where its cases come from, in words.
        is_synthetic: Whether the cases are phantoms.
        find_cohort: Run folder → the cases; reads no case yet.
        check_cohort: Raises StudyError for settings that don't fit these cases.
    """

    name: str
    settings: JobSettings
    data: str
    is_synthetic: bool
    find_cohort: Callable[[Path], Cohort]
    check_cohort: Callable[[Cohort], None] = lambda cohort: None


@dataclass(frozen=True)
class RunOptions:
    """How to run a study. No option changes the results.

    Attributes:
        cluster: Processes the cases; None: `jobs` processes do.
        memory_gb: Memory limit of each process that works on a case; None: no limit.
    """

    runs: Path = Path("runs")
    device: str = "cpu"
    jobs: int = 1
    cluster: Workers | None = None
    memory_gb: float | None = None

    @property
    def workers(self) -> Workers:
        return self.cluster or Processes(self.jobs, self.memory_gb)


def run_stages(
    job: Job, stages: Sequence[Stage[Any]], options: RunOptions, terminal: Terminal
) -> Path:
    """Bring every stage up to date.

    A damaged file of the run is deleted and made again. After an error, finished results are kept,
    and the next run continues from there.

    Returns:
        The run's folder.

    Raises:
        StudyError: If the folder belongs to another study, or too few cases are left.
        CaseFailure: If the program fails on a case.
    """
    process.keep_large_blocks()
    run_folder = options.runs / job.name
    # Read before any work, so that an unreadable file that the settings name is reported now.
    kept_settings = {stage.name: stage.settings(job.settings) for stage in stages}
    repaired: set[Path] = set()
    with alone_in(run_folder):
        if aside := make_room(run_folder, job.name, job.is_synthetic):
            terminal.say(f"the phantom results that were in {run_folder} are now in {aside}")
        while True:
            try:
                _bring_up_to_date(job, stages, kept_settings, run_folder, options, terminal)
                return run_folder
            except DamagedFile as error:
                if error.path in repaired or not error.path.is_relative_to(run_folder):
                    raise
                repaired.add(error.path)
                terminal.detail(f"{error.path} {error.found}; it will be made again")
                undo(error.path, run_folder)


def _bring_up_to_date(
    job: Job,
    stages: Sequence[Stage[Any]],
    kept_settings: Mapping[str, Any],
    run_folder: Path,
    options: RunOptions,
    terminal: Terminal,
) -> None:
    start = time.perf_counter()
    cohort, file_keys = without_withdrawn(job.find_cohort(run_folder), run_folder, terminal)
    _refuse_hopeless(file_keys, cohort.dropped)
    job.check_cohort(cohort)
    gone = take(run_folder, job.name, job.data, job.is_synthetic, file_keys)
    storage.remove_unfinished(run_folder)
    storage.write_text(run_folder / "study.yaml", job.settings.to_yaml())
    with terminal.logged_to(run_folder) as log, log.kept_errors():
        log.event(
            "run",
            study=job.name,
            synthetic=job.is_synthetic,
            data=job.data,
            stages=[_planned(stage, kept_settings[stage.name], options) for stage in stages],
        )
        if gone:
            noun = counted(len(gone), "case is", "cases are")
            terminal.detail(f"{noun} no longer part of the study; the results were deleted")
        done: dict[str, StageRecord] = {}
        case_keys: Mapping[str, str] = file_keys
        redone = 0
        for number, stage in enumerate(stages, start=1):
            inputs = {need: done[need].key for need in stage.needs} or file_keys
            kept = kept_settings[stage.name]
            key = key_of(stage.name, stage.version, kept, inputs)
            record = StageRecord.read(run_folder / stage.name)
            is_current = record is not None and record.key == key
            if record is not None and is_current:
                is_current = not _remove_damaged(record, run_folder / stage.name, terminal)
            if record is None or not is_current:
                redone += 1
                for later in stages[number - 1 :]:  # their results are out of date until redone
                    storage.remove(run_folder / later.name / STAGE_FILE)
                context = StageContext(
                    name=stage.name,
                    key=key,
                    study=job.name,
                    run_folder=run_folder,
                    settings=job.settings,
                    device=options.device,
                    jobs=options.jobs,
                    terminal=terminal,
                    cohort=cohort,
                    done=done,
                    workers=options.workers,
                    case_keys=case_keys,
                    needs=stage.needs,
                )
                log.event("stage started", stage=stage.name, cases=len(case_keys))
                record = _run_stage(stage, context, kept, inputs, start)
                log.event("stage finished", stage=stage.name, seconds=record.seconds)
            done[stage.name] = record
            case_keys = record.case_keys
            _say(terminal, number, len(stages), record, is_current)
            start = time.perf_counter()
        left_out = [Dropped(**case) for record in done.values() for case in record.dropped]
        if left_out:
            terminal.left_out(left_out)
        if not redone:
            terminal.say("nothing to do: every stage is up to date")
        log.event("run finished")


def _planned(stage: Stage[Any], kept: Any, options: RunOptions) -> dict[str, Any]:
    """Return what `workflow status` needs of a stage.

    `like` is equal for stages whose run times can be compared.
    """
    on = (options.device, options.jobs, options.cluster is not None)
    like = key_of(stage.name, stage.version, kept, on)
    return {"stage": stage.name, "like": like, "per_case": stage.per_case}


def _remove_damaged(record: StageRecord, folder: Path, terminal: Terminal) -> bool:
    """Delete files whose size has changed since the stage wrote them. True if there were any."""
    damaged = damaged_files(folder, record.files)
    for error in damaged:
        terminal.detail(f"{error.path} {error.found}; it will be made again")
        undo(error.path, folder.parent)
    return bool(damaged)


def _run_stage(
    stage: Stage[Any],
    context: StageContext[Any],
    kept: Any,
    inputs: Mapping[str, str],
    start: float,
) -> StageRecord:
    forget_peak_memory()
    outcome = stage.work(context)
    _refuse_too_few(stage.name, outcome, context.done)
    record = StageRecord(
        stage=stage.name,
        key=context.key,
        settings=_plain(kept),
        seed=context.settings.seed,
        inputs=dict(inputs),
        versions=process.versions(),
        finished_at=datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds"),
        seconds=round(time.perf_counter() - start, 2),
        peak_memory_mb=round(max(outcome.peak_memory_mb, peak_memory_mb()), 1),
        cases_in=list(context.case_keys),
        cases_out=list(outcome.case_keys),
        dropped=[vars(case) for case in outcome.dropped],
        case_keys=dict(outcome.case_keys),
        note=outcome.note,
        ran_on={**process.machine(), "device": context.device, "jobs": context.jobs},
        files=storage.fingerprints(context.folder(), files_of_stage(context.folder())),
    )
    record.write(context.folder())
    return record


def _say(terminal: Terminal, number: int, total: int, record: StageRecord, cached: bool) -> None:
    count_in, count_out = len(record.cases_in), len(record.cases_out)
    cases = counted(count_in, "case")
    cases = cases if count_in == count_out else f"{count_out} of {cases}"
    took = "up to date" if cached else duration(record.seconds)
    parts = [cases, took, record.note] if record.note else [cases, took]
    dropped = [Dropped(**case) for case in record.dropped]
    terminal.stage(number, total, record.stage, "   ".join(parts), dropped)


def _refuse_too_few(stage: str, outcome: Outcome, done: Mapping[str, StageRecord]) -> None:
    if len(outcome.case_keys) >= FEWEST_CASES:
        return
    dropped = [Dropped(**case) for record in done.values() for case in record.dropped]
    dropped += outcome.dropped
    reasons = "".join(f"\n  {case.case_id} ({case.stage}): {case.reason}" for case in dropped)
    raise StudyError(
        f"{counted(len(outcome.case_keys), 'usable case is', 'usable cases are')} left after "
        f"{stage}; a shape model needs at least {FEWEST_CASES}. Add cases, or repair the ones "
        f"dropped:{reasons or ' none'}"
    )


def _refuse_hopeless(file_keys: Mapping[str, str], dropped: Sequence[Dropped]) -> None:
    """Raise StudyError for cohorts that can't give a model, before any work."""
    if len(file_keys) < FEWEST_CASES:
        reasons = "".join(f"\n  {case.case_id}: {case.reason}" for case in dropped)
        raise StudyError(
            f"{counted(len(file_keys), 'case was', 'cases were')} found; a shape model needs at "
            f"least {FEWEST_CASES}, because one "
            f"is left out at a time to score it. Add cases.{reasons}"
        )
    if len(set(file_keys.values())) == 1:
        raise StudyError(
            f"all {len(file_keys)} cases are copies of one file, so there is no variation to "
            "model. Check data.folder and data.pattern."
        )


def _plain(kept: Any) -> Any:
    if isinstance(kept, Mapping):
        return {name: _plain(value) for name, value in kept.items()}
    return kept.model_dump(mode="json") if hasattr(kept, "model_dump") else kept

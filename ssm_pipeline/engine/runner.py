"""Run the stages of a study: each only if something that it depends on has changed."""

from __future__ import annotations

import datetime
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ssm_pipeline import storage
from ssm_pipeline.engine import process
from ssm_pipeline.engine.keys import key_of, key_of_files
from ssm_pipeline.engine.ownership import alone_in, make_room, take
from ssm_pipeline.engine.stage import JobSettings, Outcome, Stage, StageContext, StageRecord
from ssm_pipeline.engine.terminal import Terminal, duration
from ssm_pipeline.records import Cohort, Dropped, StudyError

FEWEST_CASES = 3


@dataclass(frozen=True)
class Job:
    """What is to be run, as the engine sees it.

    name           of the study, and of its folder in the runs folder.
    data           where its cases come from, in words; is_synthetic: they are no patients.
    find_cohort    run folder → the cases; reads no case yet.
    """

    name: str
    settings: JobSettings
    data: str
    is_synthetic: bool
    find_cohort: Callable[[Path], Cohort]


@dataclass(frozen=True)
class RunOptions:
    """How to run, as opposed to what: nothing here changes what is computed."""

    runs: Path = Path("runs")
    device: str = "cpu"
    jobs: int = 1


def run_stages(
    job: Job, stages: Sequence[Stage[Any]], options: RunOptions, terminal: Terminal
) -> Path:
    """Bring every stage up to date. Returns the run's folder.

    Raises StudyError where the folder is not ours or fewer than three cases are left, CaseFailure
    where a case breaks the code. What was finished stays, and the next run goes on from there.
    """
    process.keep_large_blocks()
    run_folder, settings = options.runs / job.name, job.settings
    # Before any work: a file that they name and that can't be read says so now, not hours later.
    kept_settings = {stage.name: stage.settings(settings) for stage in stages}
    with alone_in(run_folder):
        if aside := make_room(run_folder, job.name, job.is_synthetic):
            terminal.say(f"the phantom results that were in {run_folder} are now in {aside}")
        start = time.perf_counter()
        cohort = job.find_cohort(run_folder)
        file_keys = {case.case_id: key_of_files(case.files) for case in cohort.cases}
        take(run_folder, job.name, job.data, job.is_synthetic, file_keys)
        storage.write_text(run_folder / "study.yaml", settings.to_yaml())
        done: dict[str, StageRecord] = {}
        case_keys: Mapping[str, str] = file_keys
        redone = 0
        for number, stage in enumerate(stages, start=1):
            inputs = {need: done[need].key for need in stage.needs} or file_keys
            kept = kept_settings[stage.name]
            key = key_of(stage.name, stage.version, kept, inputs)
            record = StageRecord.read(run_folder / stage.name)
            is_current = record is not None and record.key == key
            if record is None or not is_current:
                redone += 1
                for later in stages[number - 1 :]:  # until redone, what they hold is of the past
                    (run_folder / later.name / "stage.json").unlink(missing_ok=True)
                context = StageContext(
                    name=stage.name,
                    key=key,
                    study=job.name,
                    run_folder=run_folder,
                    settings=settings,
                    device=options.device,
                    jobs=options.jobs,
                    terminal=terminal,
                    cohort=cohort,
                    done=done,
                    case_keys=case_keys,
                )
                record = _run_stage(stage, context, kept, inputs, start)
            done[stage.name] = record
            case_keys = record.case_keys
            _say(terminal, number, len(stages), record, is_current)
            start = time.perf_counter()
    if not redone:
        terminal.say("nothing to do: every stage is up to date")
    return run_folder


def _run_stage(
    stage: Stage[Any],
    context: StageContext[Any],
    kept: Any,
    inputs: Mapping[str, str],
    start: float,
) -> StageRecord:
    process.forget_peak_memory()
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
        peak_memory_mb=round(max(outcome.peak_memory_mb, process.peak_memory_mb()), 1),
        cases_in=list(context.case_keys),
        cases_out=list(outcome.case_keys),
        dropped=[vars(case) for case in outcome.dropped],
        case_keys=dict(outcome.case_keys),
        note=outcome.note,
    )
    record.write(context.folder())
    return record


def _say(terminal: Terminal, number: int, total: int, record: StageRecord, cached: bool) -> None:
    count_in, count_out = len(record.cases_in), len(record.cases_out)
    cases = f"{count_out} cases" if count_in == count_out else f"{count_out} of {count_in} cases"
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
        f"{len(outcome.case_keys)} usable cases are left after {stage}; a shape model needs at "
        f"least {FEWEST_CASES}. Add cases, or mend the ones dropped:{reasons or ' none'}"
    )


def _plain(kept: Any) -> Any:
    if isinstance(kept, Mapping):
        return {name: _plain(value) for name, value in kept.items()}
    return kept.model_dump(mode="json") if hasattr(kept, "model_dump") else kept

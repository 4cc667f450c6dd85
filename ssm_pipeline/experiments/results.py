"""`workflow benchmark results`: every number of the results page, computed part by part.

Each part consists of ordinary runs in the runs folder. So a command that was stopped continues
where it was, and a part that is up to date takes seconds.
"""

from __future__ import annotations

import dataclasses
import datetime
import os
import platform
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.commands.run_study import run_study
from ssm_pipeline.engine.process import versions
from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.experiments.results_file import write_part
from ssm_pipeline.experiments.results_parts import PARTS, Part
from ssm_pipeline.records import StudyError
from ssm_pipeline.runs.run import load_run
from ssm_pipeline.study.settings import StudySettings
from ssm_pipeline.study.study import read_study
from ssm_pipeline.study.yaml_settings import changed_key

# The tables of a run that a page quotes. The others are long and stay in the run.
QUOTED = (
    "comparison",
    "comparison_95",
    "fit",
    "interpolation",
    "labels_mean",
    "landmarks_mean",
    "left_out",
    "nearest_case",
    "paper",
    "recovered_modes",
    "truth_mean",
    "unseen_labels_mean",
    "unseen_specificity",
    "variance_kept",
)


def make_results(
    folder: Path,
    data: Mapping[str, Path],
    options: RunOptions,
    terminal: Terminal,
    only: Sequence[str] = (),
    changes: Sequence[str] = (),
    parts: Sequence[Part] = PARTS,
) -> list[str]:
    """Compute the parts and write them to `folder` (`results_file`).

    Args:
        data: Name → folder. A part whose data is missing is left out, unless `only` names it.
        only: The parts to compute; none: all of them.
        changes: To the settings of every study. They replace the changes of a part that concern the
            same setting, and are recorded with the results.

    Returns:
        The names of the parts that were computed.

    Raises:
        StudyError: No part has such a name, or the data of a named part is missing.
    """
    names = [part.name for part in parts]
    unknown = sorted(set(only) - set(names))
    if unknown:
        raise StudyError(f"there is no part {', '.join(unknown)}; the parts: {', '.join(names)}.")
    made = []
    for part in parts:
        if only and part.name not in only:
            continue
        if part.needs is not None and part.needs not in data:
            needed = f"{part.name} needs --data {part.needs}=FOLDER"
            if part.name in only:
                raise StudyError(f"the part {needed}.")
            terminal.say(f"left out: {needed}")
            continue
        terminal.say(f"results: {part.name}")
        all_changes = _changes(part, changes)
        settings = _settings(part, data, all_changes)
        runs, tables = _made(part, settings, options, terminal)
        write_part(folder, part.name, _facts(part, settings, all_changes, runs), tables)
        made.append(part.name)
    return made


def _changes(part: Part, requested: Sequence[str]) -> list[str]:
    """The part's own changes of other settings, and then those that were requested."""
    keys = {changed_key(change) for change in requested}
    return [change for change in part.changes if changed_key(change) not in keys] + [*requested]


def _settings(part: Part, data: Mapping[str, Path], changes: Sequence[str]) -> StudySettings:
    where = None if part.needs is None else data[part.needs]
    return read_study(part.study, where, changes).settings


def _made(
    part: Part, settings: StudySettings, options: RunOptions, terminal: Terminal
) -> tuple[list[Path], dict[str, pd.DataFrame]]:
    """The runs of a part, and its tables."""
    place = dataclasses.replace(options, runs=options.runs / "results" / part.name)
    if part.kind == "phantoms":
        from ssm_pipeline.data_prep.synthetic.phantom_seeds import REPORTED
        from ssm_pipeline.experiments.phantom_benchmark import run_phantom_benchmark

        run_phantom_benchmark(settings, place, terminal, REPORTED)
        found = {path.stem: storage.read_table(path) for path in place.runs.glob("*.csv")}
        return sorted(path.parent for path in place.runs.glob("*/study.json")), found
    if part.kind == "spread":
        from ssm_pipeline.experiments.spread import run_spread

        runs, each, mean = run_spread(part.study, settings, place, terminal)
        return runs, {"spread_runs": each, "spread": mean}
    if part.kind == "training":
        from ssm_pipeline.experiments.training_curve import run_training_curve

        run, table = run_training_curve(part.study, settings, place, terminal)
        return [run], {"training": table}
    folder = run_study(part.study, settings, place, terminal)
    tables = {n: t for n, t in load_run(folder).metrics.tables.items() if n in QUOTED}
    for name in ("losses", "epochs"):
        path = folder / "evaluation" / "S3M" / f"{name}.csv"
        if path.exists():
            tables[f"s3m_{name}"] = storage.read_table(path)
    return [folder], tables


def _facts(
    part: Part, settings: StudySettings, changes: Sequence[str], runs: Sequence[Path]
) -> dict[str, Any]:
    stages = [stage for run in runs for stage in load_run(run).stages]
    return {
        "study": part.study,
        "changes": list(changes),
        "seed": settings.seed,
        "commit": commit(),
        "machine": machine(),
        "packages": versions(),
        "minutes": round(sum(stage.seconds for stage in stages) / 60, 1),
        "finished_at": max(
            (stage.finished_at for stage in stages),
            default=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        ),
    }


def commit() -> str | None:
    """The commit of the code, with `+` if files differ from it; None outside git."""
    place = Path(__file__).parent

    def said(*words: str) -> str:
        command = ["git", "-C", str(place), *words]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    try:
        head, changed = said("rev-parse", "HEAD"), said("status", "--porcelain", "-uno")
    except (OSError, subprocess.CalledProcessError):
        return None
    return f"{head}+" if changed else head


def machine() -> str:
    """The processor and the number of cores."""
    processor = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        lines = cpuinfo.read_text(encoding="utf-8").splitlines()
        named = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
        processor = named[0] if named else processor
    return f"{processor}, {os.cpu_count()} cores, {platform.system()}"

"""`workflow run` as a function, for notebooks and scripts."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console

from ssm_pipeline.commands.run_study import run_study
from ssm_pipeline.engine.process import chosen_device, default_jobs
from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.records import require_type
from ssm_pipeline.runs.run import Run
from ssm_pipeline.study.study import read_study


def run(
    study: str | Path,
    data: str | Path | None = None,
    settings: Mapping[str, Any] | None = None,
    runs: str | Path = "runs",
    device: str | None = None,
    jobs: int | None = None,
) -> Run:
    """Run the stages of a study that are not up to date, from masks to report.

    Args:
        study: A study's name (`luna16`) or the path of its YAML.
        data: The folder with the masks.
        settings: Changes to the study's settings, by their dotted names: {"training.steps": 500}.
        runs: The folder that holds the runs.
        device: "cpu" or "cuda". None: cuda where there is one.
        jobs: The number of processes. None: as many as memory and processors allow.

    Returns:
        The finished run: its meshes, model, scores and tables.

    Raises:
        TypeError: For a study or folder that is no name and no path.
        StudyError: For what `workflow run` refuses.
    """
    require_type(study, (str, Path), "study")
    require_type(data, (str, Path, type(None)), "data", "One folder holds the masks.")
    changes = [f"{name}={yaml.safe_dump(value)}" for name, value in (settings or {}).items()]
    chosen = read_study(str(study), Path(data) if data is not None else None, changes)
    # Plain lines: in a notebook Rich would show each as a block of its own.
    console = Console(
        file=sys.stdout,
        force_jupyter=False,
        force_terminal=False,
        highlight=False,
        soft_wrap=True,
        markup=False,
    )
    terminal = Terminal(console)
    chosen.announce(terminal)
    options = RunOptions(Path(runs), chosen_device(device), jobs or default_jobs())
    return Run(run_study(chosen.name, chosen.settings, options, terminal))

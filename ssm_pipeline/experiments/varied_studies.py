"""A study that is run several times, each time with other settings, and what is read from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd

from ssm_pipeline.commands.run_study import run_study
from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.runs.run import Run, load_run
from ssm_pipeline.study.settings import StudySettings


def run_varied(
    name: str,
    title: str,
    settings: StudySettings,
    changes: Mapping[str, object],
    options: RunOptions,
    terminal: Terminal,
) -> Run:
    """Run a study with other settings, or finish that run.

    Args:
        name: Of the run's folder.
        title: The line that is printed before it starts.
        changes: Section of the settings → its new value.
    """
    terminal.say(title)
    changed = settings.model_copy(update=dict(changes))
    return load_run(run_study(name, changed, options, terminal))


def measured(run: Run, measures: Sequence[str]) -> pd.DataFrame:
    """A row per method: those of the measures that the comparison holds."""
    table = run.metrics.tables["comparison"]
    return table[["method", *(name for name in measures if name in table)]].copy()

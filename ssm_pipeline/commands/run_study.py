"""`workflow run`: run a study from its masks to its report."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from ssm_pipeline.engine.runner import Job, RunOptions, run_stages
from ssm_pipeline.engine.stage import Stage
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.stages.list import STAGES
from ssm_pipeline.study.fit_to_cohort import refuse_what_cannot_fit
from ssm_pipeline.study.settings import StudySettings


def run_study(
    name: str,
    settings: StudySettings,
    options: RunOptions,
    terminal: Terminal,
    stages: Sequence[Stage[StudySettings]] = STAGES,
) -> Path:
    """Bring every stage of a study up to date.

    Raises what `engine.runner.run_stages` raises.

    Returns:
        The run's folder.
    """
    job = Job(
        name,
        settings,
        data=settings.data.in_words,
        is_synthetic=settings.is_synthetic,
        find_cohort=settings.data.find,
        check_cohort=partial(refuse_what_cannot_fit, settings),
    )
    return run_stages(job, stages, options, terminal)

"""`workflow figures`: draw a finished run's figures for a paper."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path

from ssm_pipeline.report.settings import FigureSettings
from ssm_pipeline.runs.former_results import FIGURES, note_figures
from ssm_pipeline.runs.run import load_run
from ssm_pipeline.stages.report import report_content
from ssm_pipeline.study.yaml_settings import checked_as, merge, parse_changes


def draw_figures(run_folder: Path, formats: Sequence[str], changes: Sequence[str]) -> list[Path]:
    """Write the figures of a finished run to figures/, in each format. Raises StudyError."""
    from ssm_pipeline.report.figures import write_figures

    run = load_run(run_folder)
    content = report_content(run)
    stored = run.settings["report"]["figures"]
    written: list[Path] = []
    for format in formats:
        wanted = [*changes, f"format={format.strip()}"]
        settings = functools.reduce(merge, parse_changes(wanted), stored)
        checked_settings = checked_as(FigureSettings, settings, run_folder / "study.yaml")
        written += write_figures(content, run_folder / FIGURES, checked_settings)
    note_figures(run)
    return written

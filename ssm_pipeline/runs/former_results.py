"""Figures and comparisons in a run's folder that belong to a former model of the run."""

from __future__ import annotations

from pathlib import Path

from ssm_pipeline import storage
from ssm_pipeline.engine.stage import StageRecord
from ssm_pipeline.export.comparison_files import ABOUT_FILE
from ssm_pipeline.records import DamagedFile
from ssm_pipeline.runs.layout import MODEL
from ssm_pipeline.runs.run import COMPARISONS, Run

FIGURES = "figures"  # the folder of a run that `workflow figures` writes to
FIGURES_ABOUT = "figures.json"


def note_figures(run: Run) -> None:
    """Write down which model the figures show."""
    storage.write_json(run.folder / FIGURES / FIGURES_ABOUT, {"model_key": run.model_key})


def former_results(run_folder: Path) -> list[str]:
    """A line per folder that belongs to a former model: which, and how to renew it.

    Empty where the run has no finished model.
    """
    if StageRecord.read(run_folder / MODEL.stage) is None:
        return []
    try:
        key = Run(run_folder).model_key
    except DamagedFile:  # reported by `workflow verify`; there is no model to compare with
        return []
    lines = []
    figures = run_folder / FIGURES
    if figures.is_dir() and _told(figures / FIGURES_ABOUT).get("model_key") != key:
        lines.append(
            f"{figures} shows a former model, or one that is not known. To renew it: "
            f"workflow figures {run_folder.resolve().name}"
        )
    for about in sorted((run_folder / COMPARISONS).glob(f"*/{ABOUT_FILE}")):
        told = _told(about)
        if told.get("model_key") != key:
            lines.append(
                f"{about.parent} is of a former model. To renew it: workflow compare with the "
                f'formula "{told.get("formula", "not known")}"'
            )
    return lines


def _told(path: Path) -> dict[str, object]:
    if not path.is_file():
        return {}
    try:
        content = storage.read_json(path)
    except DamagedFile:
        return {}
    return content if isinstance(content, dict) else {}

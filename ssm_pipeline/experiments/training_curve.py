"""`workflow benchmark training`: how a study's results depend on the training.

One run is repeated with other training schedules, so that meshes and bases are made once. All
schedules use the template of the first one, so that only the networks differ.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.experiments.varied_studies import measured, run_varied
from ssm_pipeline.runs.run import Run
from ssm_pipeline.study.settings import StudySettings


@dataclass(frozen=True)
class Schedule:
    """The weights to start from, the steps, and the plateau's patience (`TrainingSettings`)."""

    start: str
    steps: int
    patience: int = 0

    def __str__(self) -> str:
        patience = ", patience" if self.patience else ""
        return f"{self.steps} steps from {self.start} weights{patience}"


SCHEDULES = (
    Schedule("built-in", 0),
    Schedule("built-in", 50),
    Schedule("built-in", 200),
    Schedule("none", 50),
    Schedule("none", 200),
    Schedule("none", 500),
    Schedule("none", 1000, patience=100),
)
_MEASURES = ("generalisation_surface_mm", "specificity_surface_mm", "surface_fit_mm")


def run_training_curve(
    study: str,
    settings: StudySettings,
    options: RunOptions,
    terminal: Terminal,
    schedules: Sequence[Schedule] = SCHEDULES,
) -> tuple[Path, pd.DataFrame]:
    """Run the study with each schedule.

    Returns:
        The folder of the run, and a row per schedule and method: start, steps, patience,
        steps_done; mean_loss and map_extent of the template on the other cases; method; the
        generalisation, specificity and fit (surface, mm) of `comparison.csv`; labels_border_mm
        where the cohort has labels, and truth_mm where its truth is known.
    """
    rows, folder = [], options.runs
    for schedule in schedules:
        run = run_varied(
            f"{study}-training",
            f"{study}: {schedule}",
            settings,
            {"training": settings.training.model_copy(update=dataclasses.asdict(schedule))},
            options,
            terminal,
        )
        settings = settings.model_copy(update={"template": run.template_id})
        rows.append(_rows(run, schedule))
        folder = run.folder
    table = pd.concat(rows, ignore_index=True)
    storage.write_table(table, options.runs / f"{study}-training.csv")
    return folder, table


def _rows(run: Run, schedule: Schedule) -> pd.DataFrame:
    folder, tables = run.folder / "training", run.metrics.tables
    losses = folder / "losses.csv"
    of_templates = storage.read_table(folder / "template_losses.csv")
    own = of_templates.set_index("case_id").loc[run.template_id]
    rows = measured(run, _MEASURES)
    if "labels_mean" in tables:
        borders = tables["labels_mean"].set_index("method")["border_mm"]
        rows["labels_border_mm"] = rows["method"].map(borders)
    if "truth" in tables:
        errors = tables["truth"].groupby("method")["geodesic_mm"].mean()
        rows["truth_mm"] = rows["method"].map(errors)
    facts = dataclasses.asdict(schedule) | {
        "steps_done": len(storage.read_table(losses)) if losses.exists() else 0,
        "mean_loss": own["mean_loss"],
        "map_extent": own["map_extent"],
    }
    return rows.assign(**facts)[[*facts, *rows.columns]]

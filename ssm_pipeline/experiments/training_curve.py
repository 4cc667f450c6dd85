"""`workflow benchmark training`: what so many steps, from so trained weights, are worth to a study.

One run, whose training changes: meshes and bases are made once. The first schedule's template is
kept for the others, so that nothing but the networks differs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.commands.run_study import run_study
from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.runs.run import load_run
from ssm_pipeline.study.settings import StudySettings


@dataclass(frozen=True)
class Schedule:
    """Weights to start from, steps, and the plateau's patience (`TrainingSettings`)."""

    start: str
    steps: int
    patience: int = 0


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
    """Run the study with each schedule. Returns the run's folder and a row per schedule and method.

    Columns: start, steps, patience, steps_done; mean_loss and map_extent, of the template tried on
    the other cases; method, `comparison.csv`'s generalisation, specificity and fit (surface, mm);
    where the cohort has labels labels_border_mm, where it has a truth truth_mm.
    """
    rows = []
    for schedule in schedules:
        words = f"{schedule.steps} steps from {schedule.start} weights"
        terminal.say(f"{study}: {words}{', patience' if schedule.patience else ''}")
        training = settings.training.model_copy(
            update={
                "start": schedule.start,
                "steps": schedule.steps,
                "patience": schedule.patience,
            }
        )
        changed = settings.model_copy(update={"training": training})
        folder = run_study(f"{study}-training", changed, options, terminal)
        settings = settings.model_copy(update={"template": load_run(folder).template_id})
        rows.append(_rows(folder, schedule))
    table = pd.concat(rows, ignore_index=True)
    storage.write_table(table, options.runs / f"{study}-training.csv")
    return folder, table


def _rows(folder: Path, schedule: Schedule) -> pd.DataFrame:
    run = load_run(folder)
    tables = run.metrics.tables
    losses = folder / "training" / "losses.csv"
    of_templates = storage.read_table(folder / "training" / "template_losses.csv")
    own = of_templates.set_index("case_id").loc[run.template_id]
    rows = tables["comparison"].set_index("method")
    rows = rows[[name for name in _MEASURES if name in rows]].copy()
    if "labels_mean" in tables:
        rows["labels_border_mm"] = tables["labels_mean"].set_index("method")["border_mm"]
    if "truth" in tables:
        rows["truth_mm"] = tables["truth"].groupby("method")["geodesic_mm"].mean()
    facts = {
        "start": schedule.start,
        "steps": schedule.steps,
        "patience": schedule.patience,
        "steps_done": len(storage.read_table(losses)) if losses.exists() else 0,
        "mean_loss": own["mean_loss"],
        "map_extent": own["map_extent"],
    }
    return rows.reset_index().assign(**facts)[[*facts, "method", *rows.columns]]

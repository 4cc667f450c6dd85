"""`workflow benchmark spread`: how much a study's results depend on the seed and on the template.

Each repetition is a run of its own; what was finished is never done again.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.commands.run_study import run_study
from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.runs.run import load_run
from ssm_pipeline.study.settings import StudySettings

MEASURES = ("generalisation_surface_mm", "specificity_surface_mm", "variance_mm2")


def run_spread(
    study: str,
    settings: StudySettings,
    options: RunOptions,
    terminal: Terminal,
    seeds: Sequence[int] | None = None,
    templates: int = 3,
) -> tuple[list[Path], pd.DataFrame, pd.DataFrame]:
    """Run the study with each seed, and with each of the best templates.

    seeds      of every random draw; None: the study's own and the two after it.
    templates  so many cases of smallest mean loss to the others, as the first run ranks them; the
               first is the study's own choice.

    Returns the runs, a row per run and method (varied, what, method and `MEASURES`), and a row per
    method: each measure's mean over all runs, and its standard deviation over the seeds and over
    the templates (…_sd_seeds, …_sd_templates).
    """
    seeds = list(range(settings.seed, settings.seed + 3)) if seeds is None else list(seeds)
    runs, rows = [], []
    for seed in seeds:
        terminal.say(f"{study}, seed {seed}")
        changed = settings.model_copy(update={"seed": seed})
        runs.append(run_study(f"{study}-seed-{seed}", changed, options, terminal))
        rows.append(_rows(runs[-1], "seed", str(seed)))
    ranked = storage.read_table(runs[0] / "training" / "template_losses.csv")
    best = ranked.sort_values("mean_loss")["case_id"].tolist()
    own = load_run(runs[0]).template_id
    rows.append(_rows(runs[0], "template", own))
    for template in [case_id for case_id in best if case_id != own][: templates - 1]:
        terminal.say(f"{study}, template {template}")
        changed = settings.model_copy(update={"template": template, "seed": seeds[0]})
        runs.append(run_study(f"{study}-template-{template}", changed, options, terminal))
        rows.append(_rows(runs[-1], "template", template))
    each = pd.concat(rows, ignore_index=True)
    return runs, each, spread_over(each)


def spread_over(each: pd.DataFrame) -> pd.DataFrame:
    """A row per method of the runs' table: means, and standard deviations by what was varied.

    >>> varied = ["seed", "seed", "template"]
    >>> each = pd.DataFrame({"varied": varied, "method": "full", "x_mm": [1.0, 3.0, 1.0]})
    >>> spread_over(each)[["x_mm", "x_mm_sd_seeds"]].round(3).values.tolist()
    [[2.0, 1.414]]
    """
    measures = [name for name in each if name not in ("varied", "what", "method")]
    once = each.drop_duplicates(["method", *measures])  # the first run is of a seed and a template
    table = once.groupby("method", sort=False)[measures].mean()
    for varied, rows in each.groupby("varied"):
        deviations = rows.groupby("method")[measures].std()
        table = table.join(deviations.add_suffix(f"_sd_{varied}s"))
    return table.reset_index()


def _rows(run: Path, varied: str, what: str) -> pd.DataFrame:
    table = load_run(run).metrics.tables["comparison"]
    rows = table[["method", *(name for name in MEASURES if name in table)]]
    return rows.assign(varied=varied, what=what)

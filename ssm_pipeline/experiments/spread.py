"""`workflow benchmark spread`: how much a study's results depend on the seed and on the template.

Each repetition is a run of its own, and a finished one is not computed again.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.experiments.varied_studies import measured, run_varied
from ssm_pipeline.runs.run import Run
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

    Args:
        seeds: Of every random draw; None: the study's own and the two after it.
        templates: How many of the cases with the smallest mean loss to the others, as the first run
            ranks them. The first of them is the study's own choice.

    Returns:
        The folders of the runs; a row per run and method (varied, what, method and `MEASURES`); and
        a row per method with the mean of each measure over all runs and its standard deviation over
        the seeds and over the templates (…_sd_seeds, …_sd_templates).
    """
    seeds = list(range(settings.seed, settings.seed + 3)) if seeds is None else list(seeds)
    runs: list[Run] = []
    rows: list[pd.DataFrame] = []

    def repeat(varied: str, what: int | str, **changes: object) -> None:
        name, title = f"{study}-{varied}-{what}", f"{study}, {varied} {what}"
        runs.append(run_varied(name, title, settings, changes, options, terminal))
        add_rows(runs[-1], varied, what)

    def add_rows(run: Run, varied: str, what: int | str) -> None:
        rows.append(measured(run, MEASURES).assign(varied=varied, what=str(what)))

    for seed in seeds:
        repeat("seed", seed, seed=seed)
    ranked = storage.read_table(runs[0].folder / "training" / "template_losses.csv")
    best = ranked.sort_values("mean_loss")["case_id"].tolist()
    own = runs[0].template_id
    add_rows(runs[0], "template", own)
    for template in [case_id for case_id in best if case_id != own][: templates - 1]:
        repeat("template", template, template=template, seed=seeds[0])
    each = pd.concat(rows, ignore_index=True)
    return [run.folder for run in runs], each, spread_over(each)


def spread_over(each: pd.DataFrame) -> pd.DataFrame:
    """A row per method: the means over the runs, and standard deviations by what was varied.

    >>> varied = ["seed", "seed", "template"]
    >>> each = pd.DataFrame({"varied": varied, "method": "full", "x_mm": [1.0, 3.0, 1.0]})
    >>> spread_over(each)[["x_mm", "x_mm_sd_seeds"]].round(3).values.tolist()
    [[2.0, 1.414]]
    """
    measures = [name for name in each if name not in ("varied", "what", "method")]
    # The first run counts for its seed and for its template.
    once = each.drop_duplicates(["method", *measures])
    table = once.groupby("method", sort=False)[measures].mean()
    for varied, rows in each.groupby("varied"):
        deviations = rows.groupby("method")[measures].std()
        table = table.join(deviations.add_suffix(f"_sd_{varied}s"))
    return table.reset_index()

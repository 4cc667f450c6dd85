"""`workflow benchmark phantoms`: the whole pipeline against the truth, twice.

Once on phantoms lying as a scanner sees patients, once with each turned by a random rotation of up
to 40 degrees. Two cases are then up to 80 degrees apart: there rigid alignment can fail, and what
the network is worth shows.
"""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.commands.run_study import run_study
from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.records import StudyError
from ssm_pipeline.stages.run import load_run
from ssm_pipeline.study.settings import PhantomData, StudySettings

TURNED_DEG = 40.0


def run_phantom_benchmark(
    settings: StudySettings, options: RunOptions, terminal: Terminal
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """A row a cohort and method, and a row a cohort and true mode; also as phantom-benchmark.csv
    and phantom-modes.csv in the runs folder.

    Columns of the first: cohort, method, geodesic_x100 (mean over all template → case pairs,
    √area-normalised), geodesic_mm, worst_case_x100, generalisation_mm and specificity_mm (Chamfer,
    all modes). Of the second: as `phantom_truth.recovered_modes`.
    """
    if not isinstance(settings.data, PhantomData):
        raise StudyError("the phantom benchmark needs phantoms: set data.source to phantoms.")
    rows, modes = [], []
    for cohort, rotation in (("as scanned", 0.0), ("turned", TURNED_DEG)):
        data = settings.data.model_copy(update={"max_rotation_deg": rotation})
        terminal.say(f"phantoms {cohort}: turned by up to {rotation:g} degrees")
        folder = run_study(
            f"phantoms-{cohort.replace(' ', '-')}",
            settings.model_copy(update={"data": data}),
            options,
            terminal,
        )
        tables = load_run(folder).metrics.tables
        rows += _rows(cohort, tables)
        if "recovered_modes" in tables:  # not where size is removed, which changes the modes
            modes.append(tables["recovered_modes"].assign(cohort=cohort))
    methods = pd.DataFrame(rows)
    all_modes = pd.concat(modes) if modes else pd.DataFrame()
    for name, table in (("phantom-benchmark", methods), ("phantom-modes", all_modes)):
        with storage.written_whole(options.runs / f"{name}.csv") as temporary:
            table.to_csv(temporary, index=False)
    return methods, all_modes


def _rows(cohort: str, tables: Mapping[str, pd.DataFrame]) -> list[dict[str, object]]:
    errors, rows = tables["truth"], []
    for row in tables["comparison"].itertuples():
        own = errors[errors["method"] == row.method]
        rows.append(
            {
                "cohort": cohort,
                "method": row.method,
                "geodesic_x100": own["geodesic_x100"].mean(),
                "geodesic_mm": own["geodesic_mm"].mean(),
                "worst_case_x100": own["geodesic_x100"].max(),
                "generalisation_mm": row.generalisation_chamfer_mm,
                "specificity_mm": row.specificity_chamfer_mm,
            }
        )
    return rows

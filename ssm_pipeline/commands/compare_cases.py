"""`workflow compare`: the shapes of a run against a table of covariates."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.commands.export_folder import note_export
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.records import StudyError
from ssm_pipeline.stages.run import load_run
from ssm_pipeline.statistics.compare import ShapeComparison, compare
from ssm_pipeline.statistics.covariates import design_of, matched_to_cases
from ssm_pipeline.study.study import read_run_settings

SEPARATORS = {".tsv": "\t", ".csv": ","}


def compare_cases(
    run_folder: Path,
    covariates: Path,
    formula: str,
    folder: Path | None = None,
    mode_count: int | None = None,
    permutations: int = 4999,
    terminal: Terminal | None = None,
) -> ShapeComparison:
    """Test the formula's terms, and write tables, maps and a page to `folder` (in the run's own,
    named after the formula, where None).

    Raises StudyError for a table or a formula that does not fit the run.
    """
    from ssm_pipeline.report.compare_page import write_compare_page

    terminal = terminal or Terminal()
    run, settings = load_run(run_folder), read_run_settings(run_folder)
    design = design_of(formula, matched_to_cases(read_table(covariates), run.cases))
    terminal.say(f"{len(run.cases)} cases, {', '.join(column.name for column in design.columns)}")
    result = compare(
        run.model,
        run.aligned.vertices,
        design,
        np.random.default_rng(settings.seed),
        mode_count,
        permutations,
    )
    words = re.sub(r"[^a-z0-9]+", "-", formula.lower()).strip("-")
    folder = folder or run_folder / "compare" / words
    note_export(run_folder, folder)  # it names the cases: `workflow forget` tells of it
    write_comparison(result, folder)
    name = run.folder.resolve().name
    write_compare_page(result, run.model, folder / "index.html", name, settings.is_synthetic)
    for row in result.tests.itertuples():
        terminal.say(
            f"{row.term}   p = {row.hotelling_p:.4g} (Hotelling, {row.modes} modes), "
            f"{row.procrustes_p:.4g} (Procrustes, all)   explains "
            f"{row.explained_percent:.1f} % of the variance that the others leave"
        )
    terminal.say(f"page: {folder / 'index.html'}")
    return result


def read_table(path: Path) -> pd.DataFrame:
    """A CSV or TSV of covariates; ids stay text. Raises StudyError."""
    separator = SEPARATORS.get(path.suffix.lower())
    if separator is None:
        raise StudyError(f"{path} is neither .tsv nor .csv. Save the table as one of these.")
    text = {"case_id": str, "participant_id": str}
    try:
        # "n/a" is BIDS's empty cell, and pandas knows it.
        return pd.read_csv(path, sep=separator, dtype=text)
    except (OSError, ValueError) as error:  # pandas' parser errors are ValueErrors
        raise StudyError(f"the table {path} can't be read: {error}.") from error


def write_comparison(result: ShapeComparison, folder: Path) -> None:
    """tests.csv, modes.csv, power.csv, vertex_maps.npz, and compare.json: what was asked."""
    for name in ("tests", "modes", "power"):
        with storage.written_whole(folder / f"{name}.csv") as temporary:
            getattr(result, name).to_csv(temporary, index=False)
    arrays: dict[str, np.ndarray] = {}
    for index, one in enumerate(result.maps):
        arrays |= {
            f"displacement_mm_{index}": one.displacement_mm,
            f"p_{index}": one.p,
            f"q_{index}": one.q,
        }
    with storage.written_whole(folder / "vertex_maps.npz") as temporary:
        np.savez_compressed(temporary, **arrays)  # type: ignore[arg-type]
    about = {
        "formula": result.design.formula,
        "cases": len(result.design.matrix),
        "columns": [dataclasses.asdict(column) for column in result.design.columns],
        "modes_tested_together": result.mode_count,
        "maps": [one.name for one in result.maps],
        "tests": json.loads(result.tests.to_json(orient="records")),
    }
    storage.write_json(folder / "compare.json", about)

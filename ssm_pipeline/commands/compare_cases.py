"""`workflow compare`: the shapes of a run against a table of covariates."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ssm_pipeline.commands.export_folder import note_export
from ssm_pipeline.counting import counted
from ssm_pipeline.data_prep.cohorts.patients import advice_on_patients
from ssm_pipeline.data_prep.formats.tables import read_table, typed
from ssm_pipeline.engine.keys import key_of
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.export.comparison_files import write_comparison
from ssm_pipeline.records import StudyError
from ssm_pipeline.runs.run import COMPARISONS, Run, load_run
from ssm_pipeline.stages.report import renew_report
from ssm_pipeline.statistics.compare import ShapeComparison, compare
from ssm_pipeline.statistics.covariates import (
    case_ids_of,
    design_of,
    matched_to_cases,
    variables_of,
)
from ssm_pipeline.study.study import read_run_settings


def compare_cases(
    run_folder: Path,
    covariates: Path,
    formula: str,
    folder: Path | None = None,
    mode_count: int | None = None,
    permutations: int = 4999,
    terminal: Terminal | None = None,
) -> ShapeComparison:
    """Test the formula's terms, and write tables, maps and a page of them to `folder`.

    Args:
        folder: None: a folder in the run, named after the formula; the report then shows it too.

    Raises:
        StudyError: If the table or the formula does not fit the run.
    """
    from ssm_pipeline.report.compare_page import write_compare_page

    terminal = terminal or Terminal()
    run, settings = load_run(run_folder), read_run_settings(run_folder)
    _refuse_doubled_patients(run)
    if advice := advice_on_patients(run.patients):
        terminal.say(advice)
    table = read_table(covariates)
    table = typed(table, [name for name in variables_of(formula) if name in table])
    left_out = {case.case_id: case.reason for case in run.dropped}
    rows = matched_to_cases(table, run.cases, left_out)
    for case_id in sorted(set(case_ids_of(table)) & set(left_out)):
        terminal.say(f"row of {case_id} not used: the run left the case out, {left_out[case_id]}")
    design = design_of(formula, rows)
    terminal.say(f"{counted(len(run.cases), 'case')}, {', '.join(c.name for c in design.columns)}")
    result = compare(
        run.model,
        run.aligned.vertices,
        design,
        np.random.default_rng(settings.seed),
        mode_count,
        permutations,
    )
    place = folder or run_folder / COMPARISONS / folder_name(formula)
    note_export(run_folder, place)  # it names the cases: `workflow forget` tells of it
    write_comparison(result, place, run.model_key)
    page = place / "index.html"
    name = run.folder.resolve().name
    write_compare_page(result, run.model, page, name, settings.is_synthetic)
    report = renew_report(run, settings.report) if folder is None else None
    for row in result.tests.itertuples():
        terminal.say(
            f"{row.term}   T² = {row.hotelling_t2:.4g}, p = {row.hotelling_p:.4g} (Hotelling, "
            f"{counted(row.modes, 'mode')})   "
            f"F({row.procrustes_df}, {row.procrustes_residual_df}) = {row.procrustes_f:.4g}, "
            f"p = {row.procrustes_p:.4g} (Procrustes, all modes)   "
            f"explains {row.explained_percent:.1f} % of the variance that the others leave"
        )
    terminal.say(f"page: {page}")
    if report is not None:
        terminal.say(f"tab Compare: {report}")
    return result


def folder_name(formula: str) -> str:
    """Return the name of a formula's results folder; it differs between formulas.

    >>> folder_name("~ sex + age"), folder_name("~ sex:age")
    ('sex-age', 'sex-age-8846')
    """
    words = re.sub(r"[^a-z0-9]+", "-", formula.lower()).strip("-") or "formula"
    if re.fullmatch(r"~?\s*[a-z0-9]+(\s*\+\s*[a-z0-9]+)*\s*", formula):
        return words
    return f"{words}-{key_of(formula.strip())[:4]}"


def _one_case_each(run: Run) -> str:
    """The setting that leaves one case per patient; only LUNA16 has data.side."""
    is_luna16 = run.settings["data"].get("source") == "luna16"
    return f"set {'data.side to one side, or ' * is_luna16}data.cases to one case of each"


def _refuse_doubled_patients(run: Run) -> None:
    """Raise StudyError for several cases of one patient: permutation tests need independence."""
    copies = run.copies[run.copies["case_id"].isin(run.cases)]
    if not copies.empty:
        lines = "".join(f"\n    {line}" for line in copies["exclude"])
        raise StudyError(
            f"{run.folder} holds {counted(len(copies), 'copy', 'copies')} among its "
            f"{len(run.cases)} cases, and the tests would count them twice. Add to the study, and "
            "run it again:\n"
            f"data:\n  exclude:{lines}"
        )
    patients = list(run.patients.values())
    if doubled := sorted({name for name in patients if patients.count(name) > 1}):
        raise StudyError(
            f"{counted(len(doubled), 'patient has', 'patients have')} several cases in "
            f"{run.folder}: "
            f"{', '.join(doubled[:3])}{' …' if len(doubled) > 3 else ''}. The tests assume "
            "independent cases, and would find effects that do not exist. Compare a run with one "
            f"case per patient: {_one_case_each(run)}."
        )

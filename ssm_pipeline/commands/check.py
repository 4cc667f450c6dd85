"""`workflow check`: read every case of a study and report problems before a long run."""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path

import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.cohort_check.copies import advice_on_copies, copies_table
from ssm_pipeline.comparison.anatomy import evaluation_depends_on
from ssm_pipeline.data_prep.cohorts.patients import advice_on_patients
from ssm_pipeline.engine.per_case import CaseTask, Row, map_cases
from ssm_pipeline.engine.runner import FEWEST_CASES
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.engine.workers import Processes
from ssm_pipeline.meshing.settings import MeshingSettings
from ssm_pipeline.records import CaseSource, Mesh
from ssm_pipeline.runs.layout import MESH
from ssm_pipeline.stages.report import report_dependencies
from ssm_pipeline.study.fit_to_cohort import refuse_what_cannot_fit
from ssm_pipeline.study.settings import StudySettings
from ssm_pipeline.study.study import Study


def check_study(study: Study, terminal: Terminal, jobs: int = 1, to: Path | None = None) -> bool:
    """True if every case can be read and meshed and enough of them can be used.

    without it nothing is written.

    Args:
        jobs: Number of cases processed at a time.
        to: A folder for cohort_check.csv and a picture of each striking case.

    Raises:
        StudyError: If settings don't fit the cases.
    """
    _refuse_unreadable_landmarks(study.settings)
    terminal.say(f"settings   {study.path}: valid")
    data = study.settings.data
    if data.source == "phantoms":
        terminal.say("masks      none given; a run would make synthetic phantoms")
        return True
    cohort = data.find(Path())
    refuse_what_cannot_fit(study.settings, cohort)
    patients = {case.case_id: case.patient or case.case_id for case in cohort.cases}
    if advice := advice_on_patients(patients):
        terminal.say(f"patients   {advice}")
    for case in cohort.dropped:
        terminal.detail(f"case {case.case_id}: {case.reason}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        tasks = [
            CaseTask(case.case_id, "", partial(_read_case, case, study.settings.meshing))
            for case in cohort.cases
        ]
        with terminal.steps(data.noun, len(tasks)) as steps:
            results = map_cases(tasks, folder, Processes(jobs), steps.advance_to)
        usable = [result for result in results if result.dropped is None]
        for result in results:
            for warning in result.row.get("warnings", [result.dropped]):
                terminal.detail(f"case {result.case_id}: {warning}")
        terminal.say(f"{data.noun:<10} {len(usable)} of {len(results)} can be read")
        if len(usable) < FEWEST_CASES:
            terminal.say(f"           at least {FEWEST_CASES} are needed")
        else:
            meshes = [MESH.read(folder / r.case_id / MESH.name) for r in usable]
            left_out = {r.case_id: r.row["left_out_percent"] for r in usable}
            _compare(meshes, left_out, study.settings, terminal, to)
    return len(usable) == len(results) and len(usable) >= FEWEST_CASES


def _refuse_unreadable_landmarks(settings: StudySettings) -> None:
    """What the evaluation and the report depend on includes landmark files: read them.

    Raises:
        StudyError: If one is missing or can't be read.
    """
    evaluation_depends_on(settings)
    report_dependencies(settings)


def _read_case(case: CaseSource, settings: MeshingSettings, folder: Path) -> Row:
    """mesh.npz, a coarse one."""
    from ssm_pipeline.meshing.quick_mesh import quick_mesh

    given = case.load()
    mesh, quality = quick_mesh(given, settings)
    storage.save(mesh, folder / MESH.name)
    return {
        "warnings": [*given.warnings, *quality.warnings],
        "left_out_percent": 100 * quality.left_out_ml / quality.mask_volume_ml,
    }


def _compare(
    meshes: list[Mesh],
    left_out: dict[str, float],
    settings: StudySettings,
    terminal: Terminal,
    to: Path | None,
) -> None:
    from ssm_pipeline.cohort_check.check import check_with_twins

    table, pairs = check_with_twins(meshes, settings.seed, left_out)
    striking = table[table["remarks"] != ""]
    for case_id, remarks in zip(striking["case_id"], striking["remarks"], strict=True):
        terminal.detail(f"case {case_id}: {remarks}")
    terminal.say(f"cohort     {len(striking)} of {len(table)} do not look like the others")
    for line in advice_on_copies(copies_table(pairs)):
        terminal.say(f"           {line}")
    if to is not None:
        _write(table, meshes, to)
        terminal.say(f"table and pictures: {to}")


def _write(table: pd.DataFrame, meshes: list[Mesh], to: Path) -> None:
    from ssm_pipeline.report.check_pictures import picture_beside

    storage.write_table(table, to / "cohort_check.csv")
    by_id = {mesh.case_id: mesh for mesh in meshes}
    ordinary = table.loc[table["remarks"] == "", "case_id"].tolist()
    for case_id in table.loc[table["remarks"] != "", "case_id"]:
        beside = by_id[ordinary[0] if ordinary else meshes[0].case_id]
        with storage.written_whole(to / f"{case_id}.png") as temporary:
            temporary.write_bytes(picture_beside(by_id[case_id], beside))

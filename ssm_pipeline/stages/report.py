"""Gather what the stages left and write the report page; nothing is computed again."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.data_prep.cohorts.patients import advice_on_patients
from ssm_pipeline.data_prep.formats.landmarks import read_landmarks
from ssm_pipeline.engine.keys import key_of_files
from ssm_pipeline.engine.left_files import CASE_FILE, files_of_stage
from ssm_pipeline.engine.process import versions
from ssm_pipeline.engine.stage import Outcome, StageRecord
from ssm_pipeline.methods import FULL
from ssm_pipeline.report.settings import ReportSettings
from ssm_pipeline.runs.context import Context, run_of
from ssm_pipeline.runs.former_results import former_results
from ssm_pipeline.runs.landmark_file import landmarks_on_template
from ssm_pipeline.runs.layout import LOSSES, REPORT_PAGE
from ssm_pipeline.runs.run import Run
from ssm_pipeline.study.settings import StudySettings

if TYPE_CHECKING:
    from ssm_pipeline.report.content import ReportContent


def report_dependencies(settings: StudySettings) -> dict[str, Any]:
    """Its settings, and what the landmark file holds.

    Raises:
        StudyError: If it can't be read.
    """
    path = settings.report.landmarks
    if path is None:
        return {"report": settings.report}
    read_landmarks(path)
    return {"report": settings.report, "landmarks": key_of_files([path])}


def write_report(context: Context) -> Outcome:
    """index.html: the page, one file."""
    _write_page(run_of(context), context.settings.report)
    for line in former_results(context.run_folder):
        context.terminal.detail(line)
    return Outcome(context.case_keys)


def renew_report(run: Run, settings: ReportSettings) -> Path | None:
    """Write the page of a finished run again, with the comparisons made since; None where the run
    has no report yet."""
    record = StageRecord.read(run.folder / "report")
    if record is None:
        return None
    path = _write_page(run, settings)
    files = storage.fingerprints(path.parent, files_of_stage(path.parent))
    dataclasses.replace(record, files=files).write(path.parent)
    return path


def _write_page(run: Run, settings: ReportSettings) -> Path:
    from ssm_pipeline.report.page import write_page

    path = run.where(REPORT_PAGE)
    write_page(page_content(run, settings), path, settings)
    return path


def page_content(run: Run, settings: ReportSettings) -> ReportContent:
    """Read what the page shows, with the landmarks that the settings name."""
    content = report_content(run)
    if settings.landmarks is None:
        return content
    return dataclasses.replace(content, landmarks=landmarks_on_template(settings.landmarks, run))


def report_content(run: Run) -> ReportContent:
    """What the report shows, read from the files of a run's stages."""
    from ssm_pipeline.evaluation.aligned_cohort import move_meshes
    from ssm_pipeline.report.content import ReportContent

    of_cases = run.frames  # read once
    frames = [of_cases[case_id] for case_id in run.cases]
    meshes = [run.mesh(case_id) for case_id in run.cases]
    tables = dict(run.metrics.tables)
    tables["compactness"] = tables["compactness"].rename(columns={"compactness": "share"})
    fits = tables.pop("correspondence")
    fits = fits[fits["method"] == FULL].drop(columns=["method", "seed"])
    is_synthetic = run.settings["data"]["source"] == "phantoms"
    return ReportContent(
        study=run.folder.name,
        is_synthetic=is_synthetic,
        model=run.model,
        aligned=run.aligned,
        frames=tuple(frames),
        meshes=tuple(move_meshes(meshes, run.cases, frames)),
        paths=tuple(run.path(case_id) for case_id in run.path_cases),
        correspondence=fits.rename(columns={"fit_mm": "surface_mm", "fit_hd95_mm": "hd95_mm"}),
        metrics=tables,
        cohort=_cohort(run),
        stages=tuple(
            {
                "name": record.stage,
                "seconds": _seconds(record, run.folder / record.stage),
                "peak_memory_mb": record.peak_memory_mb,
                "cases_in": len(record.cases_in),
                "cases_out": len(record.cases_out),
            }
            for record in run.stages
            if record.stage != "report"
        ),
        settings=run.settings,
        versions=versions(),
        seed=run.settings["seed"],
        training=_losses(run),
        check=run.cohort_check,
        copies=run.copies,
        patients_advice="" if is_synthetic else advice_on_patients(run.patients),
        comparisons=run.comparisons,
        check_pictures={
            path.stem: path.read_bytes()
            for path in sorted((run.stage_folder("cohort_check") / "pictures").glob("*.png"))
        },
    )


def _seconds(record: StageRecord, folder: Path) -> float | None:
    """Seconds that a stage took; None if all of its cases were reused from an earlier run."""
    cases = [storage.read_json(path) for path in sorted(folder.glob(f"*/{CASE_FILE}"))]
    on_cases = sum(float(case.get("seconds", 0.0)) for case in cases)
    is_reused = record.seconds < 0.1 and on_cases > 10 * record.seconds + 0.1
    return None if is_reused else record.seconds


def _losses(run: Run) -> pd.DataFrame | None:
    """A row per step of the training; None for a study without a network."""
    return run.load(LOSSES) if run.where(LOSSES).exists() else None


def _cohort(run: Run) -> pd.DataFrame:
    """Mesh quality a case, and the reasons of those left out."""
    quality = run.mesh_quality.set_index("case_id")
    reasons = {case.case_id: f"{case.stage}: {case.reason}" for case in run.dropped}
    left_out = [case_id for case_id in reasons if case_id not in quality.index]
    table = quality.reindex([*quality.index, *left_out]).reset_index(names="case_id")
    table["dropped"] = [reasons.get(case_id, "") for case_id in table["case_id"]]
    return table.fillna({"warnings": ""})

"""Gather what the stages left and write the report page; nothing is computed again."""

from __future__ import annotations

import pandas as pd

from ssm_pipeline.pipeline.evaluation_stage import FULL
from ssm_pipeline.pipeline.process import versions
from ssm_pipeline.pipeline.run import Run
from ssm_pipeline.pipeline.stage import Outcome, StageContext


def write_report(context: StageContext) -> Outcome:
    """index.html: the page, one file."""
    from ssm_pipeline.evaluation.model_quality import move_meshes
    from ssm_pipeline.report.content import ReportContent
    from ssm_pipeline.report.page import write_page

    run = Run(context.run_folder)
    frames = [run.frames[case_id] for case_id in run.cases]
    meshes = [run.mesh(case_id) for case_id in run.cases]
    tables = dict(run.metrics.tables)
    tables["compactness"] = tables["compactness"].rename(columns={"compactness": "share"})
    fits = tables.pop("correspondence")
    fits = fits[fits["method"] == FULL].drop(columns=["method", "seed"])
    content = ReportContent(
        study=context.study,
        is_synthetic=context.cohort.is_synthetic,
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
                "seconds": record.seconds,
                "peak_memory_mb": record.peak_memory_mb,
                "cases_in": len(record.cases_in),
                "cases_out": len(record.cases_out),
            }
            for record in context.done.values()
        ),
        settings=context.settings.model_dump(mode="json"),
        versions=versions(),
        seed=context.seed,
    )
    write_page(content, context.folder() / "index.html", context.settings.report)
    return Outcome(context.case_keys)


def _cohort(run: Run) -> pd.DataFrame:
    """Mesh quality a case, and the reasons of those left out."""
    quality = run.mesh_quality.set_index("case_id")
    reasons = {case.case_id: f"{case.stage}: {case.reason}" for case in run.dropped}
    left_out = [case_id for case_id in reasons if case_id not in quality.index]
    table = quality.reindex([*quality.index, *left_out]).reset_index(names="case_id")
    table["dropped"] = [reasons.get(case_id, "") for case_id in table["case_id"]]
    return table.fillna({"warnings": ""})

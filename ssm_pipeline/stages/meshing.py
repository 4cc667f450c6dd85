"""Stage `meshing`: every mask, or surface as it came, to a mesh."""

from __future__ import annotations

import dataclasses
from functools import partial
from pathlib import Path
from typing import Any

from ssm_pipeline import storage
from ssm_pipeline.engine.per_case import CaseTask, Row
from ssm_pipeline.engine.stage import Outcome
from ssm_pipeline.meshing.settings import MeshingSettings
from ssm_pipeline.records import CaseSource, Surface
from ssm_pipeline.runs.context import Context
from ssm_pipeline.runs.layout import LABELS, MESH
from ssm_pipeline.study.settings import StudySettings


def make_meshes(context: Context) -> Outcome:
    """<case>/mesh.npz, labels.npz where the masks have several parts; quality.csv."""
    settings, depends_on = context.settings.meshing, meshing_dependencies(context.settings)
    results = context.map_cases(
        [
            CaseTask(
                case.case_id,
                context.case_key(case.case_id, depends_on),
                partial(mesh_case, case, settings),
            )
            for case in context.cohort.cases
            if case.case_id in context.case_keys
        ]
    )
    context.write_table("quality", [result.row for result in results if not result.dropped])
    return context.outcome(results)


def meshing_dependencies(settings: StudySettings) -> Any:
    """The settings of meshing, and whether labels of parts are kept."""
    if not settings.data.has_parts:
        return settings.meshing
    return {"meshing": settings.meshing, "labels": True}


def mesh_case(case: CaseSource, settings: MeshingSettings, folder: Path) -> Row:
    """mesh.npz, labels.npz of several parts; the row: quality, what to know of the case."""
    from ssm_pipeline.meshing.mask_to_mesh import mesh_with_quality
    from ssm_pipeline.meshing.surface_labels import surface_labels
    from ssm_pipeline.meshing.surface_to_mesh import mesh_from_surface

    given = case.load()
    if isinstance(given, Surface):
        mesh, quality = mesh_from_surface(given, settings)
    else:
        mesh, quality = mesh_with_quality(given, settings)
        if given.labels is not None:
            storage.save(surface_labels(mesh, given), folder / LABELS.name)
    storage.save(mesh, folder / MESH.name)
    remarks = {"warnings": "; ".join([*given.warnings, *quality.warnings])}
    return {"case_id": case.case_id, **dataclasses.asdict(quality), **remarks}

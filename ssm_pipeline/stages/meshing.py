"""Stage `meshing`: every mask, or surface as it came, to a mesh."""

from __future__ import annotations

import dataclasses
from functools import partial
from pathlib import Path

from ssm_pipeline import storage
from ssm_pipeline.engine.per_case import CaseTask, Row
from ssm_pipeline.engine.stage import Outcome
from ssm_pipeline.meshing.settings import MeshingSettings
from ssm_pipeline.records import CaseSource, Surface
from ssm_pipeline.stages.context import Context


def make_meshes(context: Context) -> Outcome:
    """<case>/mesh.npz; quality.csv."""
    settings = context.settings.meshing
    results = context.map_cases(
        [
            CaseTask(
                case.case_id,
                context.case_key(case.case_id, settings),
                partial(mesh_case, case, settings),
            )
            for case in context.cohort.cases
            if case.case_id in context.case_keys
        ]
    )
    context.write_table("quality", [result.row for result in results if not result.dropped])
    return context.outcome(results)


def mesh_case(case: CaseSource, settings: MeshingSettings, folder: Path) -> Row:
    """mesh.npz; the row is its quality, and what a reader should know of the case."""
    from ssm_pipeline.meshing.mask_to_mesh import mesh_from_mask
    from ssm_pipeline.meshing.surface_to_mesh import mesh_from_surface

    given = case.load()
    if isinstance(given, Surface):
        mesh, quality = mesh_from_surface(given, settings)
    else:
        mesh, quality = mesh_from_mask(given, settings)
    storage.save(mesh, folder / "mesh.npz")
    remarks = {"warnings": "; ".join([*given.warnings, *quality.warnings])}
    return {"case_id": case.case_id, **dataclasses.asdict(quality), **remarks}

"""How far a real case lies from the most like of the others: what specificity is read against."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ssm_pipeline.evaluation.settings import EvaluationSettings
from ssm_pipeline.evaluation.specificity import even_samples
from ssm_pipeline.geometry.distances import (
    PointTarget,
    SurfaceTarget,
    chamfer,
    surface_distance,
)
from ssm_pipeline.records import Mesh


def nearest_other_cases(
    meshes: Sequence[Mesh], settings: EvaluationSettings, generator: np.random.Generator
) -> pd.DataFrame:
    """For each case the nearest other one.

    meshes   the cases' own meshes in the model's frame.
    Returns  one row per case: case_id; nearest_by_surface, surface_mm; nearest_by_chamfer,
             chamfer_mm; chamfer_floor_mm, the Chamfer distance of two samplings of the case itself.
             A model whose draws lie much nearer to a case than cases do to each other varies too
             little.
    """
    points = [PointTarget.of(even_samples(m, settings.points, generator)) for m in meshes]
    again = [PointTarget.of(even_samples(m, settings.points, generator)) for m in meshes]
    surfaces = [SurfaceTarget.of(mesh.vertices, mesh.faces) for mesh in meshes]
    by_chamfer, by_surface = np.full((2, len(meshes), len(meshes)), np.inf)
    for a in range(len(meshes)):
        for b in range(a):
            by_chamfer[a, b] = by_chamfer[b, a] = chamfer(points[a], points[b])
            by_surface[a, b] = by_surface[b, a] = surface_distance(surfaces[a], surfaces[b]).mean
    return pd.DataFrame(
        {
            "case_id": [mesh.case_id for mesh in meshes],
            "nearest_by_surface": [meshes[i].case_id for i in by_surface.argmin(axis=1)],
            "surface_mm": by_surface.min(axis=1),
            "nearest_by_chamfer": [meshes[i].case_id for i in by_chamfer.argmin(axis=1)],
            "chamfer_mm": by_chamfer.min(axis=1),
            "chamfer_floor_mm": [chamfer(a, b) for a, b in zip(points, again, strict=True)],
        }
    )

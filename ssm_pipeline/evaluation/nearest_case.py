"""How far a real case lies from the most like of the others: what specificity is read against."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ssm_pipeline.evaluation.settings import EvaluationSettings
from ssm_pipeline.evaluation.specificity import estimates, even_samples, even_subset
from ssm_pipeline.geometry.distances import (
    PointTarget,
    SurfaceTarget,
    chamfer,
    surface_distance,
)
from ssm_pipeline.records import Mesh

CANDIDATES = 10  # other cases compared in full
MOST_ASKED = 500  # cases: each is compared with all others, which for all would be N²


def nearest_other_cases(
    meshes: Sequence[Mesh], settings: EvaluationSettings, generator: np.random.Generator
) -> pd.DataFrame:
    """For each case the nearest other one.

    A few points of all others choose those that are compared in full.

    Args:
        meshes: The cases' own meshes in the model's frame.

    Returns:
        One row per case, or for MOST_ASKED of them, evenly chosen, where there are more: case_id;
        nearest_by_surface, surface_mm; nearest_by_chamfer, chamfer_mm; chamfer_floor_mm, the
        Chamfer distance of two samplings of the case itself. A model whose draws lie much nearer to
        a case than cases do to each other varies too little.
    """
    points = [PointTarget.of(even_samples(m, settings.points, generator)) for m in meshes]
    again = [PointTarget.of(even_samples(m, settings.points, generator)) for m in meshes]
    surfaces = [SurfaceTarget.of(mesh.vertices, mesh.faces) for mesh in meshes]
    few = even_subset(settings.points, settings.screening_points)
    rows = []
    for case in even_subset(len(meshes), MOST_ASKED):
        others = [other for other in range(len(meshes)) if other != case]
        rough, _ = estimates(points[case], [points[other] for other in others], few)
        near = [others[index] for index in rough.argsort()[:CANDIDATES]]
        by_chamfer = [chamfer(points[case], points[other]) for other in near]
        by_surface = [surface_distance(surfaces[case], surfaces[other]).mean for other in near]
        rows.append(
            {
                "case_id": meshes[case].case_id,
                "nearest_by_surface": meshes[near[int(np.argmin(by_surface))]].case_id,
                "surface_mm": min(by_surface),
                "nearest_by_chamfer": meshes[near[int(np.argmin(by_chamfer))]].case_id,
                "chamfer_mm": min(by_chamfer),
                "chamfer_floor_mm": chamfer(points[case], again[case]),
            }
        )
    return pd.DataFrame(rows)

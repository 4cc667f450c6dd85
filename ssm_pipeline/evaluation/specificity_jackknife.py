"""What specificity would have been without each case: its uncertainty over cases, not over draws.

A bootstrap over the cases would hold many of them twice, and a model's draws then find a mesh that
it was built on twice: specificity of such cohorts is another quantity. Leaving one case out at a
time has no such fault, and asks for N models only.
"""

from __future__ import annotations

from collections.abc import Sequence

import joblib
import numpy as np
import pandas as pd

from ssm_pipeline.evaluation.sampling import FixedPoints
from ssm_pipeline.evaluation.settings import EvaluationSettings
from ssm_pipeline.evaluation.specificity import (
    drawn_scores,
    estimates,
    even_samples,
    nearest_surface,
)
from ssm_pipeline.geometry.distances import PointTarget, SurfaceTarget
from ssm_pipeline.records import CorrespondedShapes, Mesh
from ssm_pipeline.shape_model.pca import build

_CANDIDATES = 3  # meshes nearest by Chamfer of a few points, compared by surface distance


def without_each_case(
    aligned: CorrespondedShapes,
    meshes: Sequence[Mesh],
    modes: int,
    settings: EvaluationSettings,
    generator: np.random.Generator,
    jobs: int = 1,
) -> pd.DataFrame:
    """Specificity of the models built without each case, by surface distance to the other meshes.

    aligned, meshes  N shapes and their meshes in the model's frame, in the same order.
    modes            of each model, at most N − 2.
    Returns two rows per case, one for each half of the draws: case_id (left out), modes, half,
    surface_mm (the mean over the draws). The weights of the draws are the same for every case left
    out and every method, so that only what the case changes is seen.
    """
    count = len(aligned.case_ids)
    weights = generator.standard_normal((settings.jackknife_samples, count))
    mean = aligned.vertices.mean(axis=0)
    points = FixedPoints.of(mean, aligned.faces, settings.screening_points, generator)
    samples = [even_samples(mesh, points.count, generator) for mesh in meshes]
    tasks = [
        joblib.delayed(_without_each)(
            aligned, meshes, part.tolist(), modes, weights, points, samples, settings
        )
        for part in np.array_split(np.arange(count), min(jobs, count))
    ]
    with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
        rows = joblib.Parallel(n_jobs=jobs, batch_size=1)(tasks)
    return pd.DataFrame([row for part in rows for row in part])


def _without_each(
    aligned: CorrespondedShapes,
    meshes: Sequence[Mesh],
    cases: Sequence[int],
    modes: int,
    weights: np.ndarray,
    points: FixedPoints,
    samples: Sequence[np.ndarray],
    settings: EvaluationSettings,
) -> list[dict[str, object]]:
    """The rows of some of the cases; the meshes' trees are built once for all of them."""
    targets = [PointTarget.of(sample) for sample in samples]
    surfaces = [SurfaceTarget.of(mesh.vertices, mesh.faces) for mesh in meshes]
    return [
        row
        for case in cases
        for row in _without(aligned, case, modes, weights, points, targets, surfaces, settings)
    ]


def _without(
    aligned: CorrespondedShapes,
    case: int,
    modes: int,
    weights: np.ndarray,
    points: FixedPoints,
    targets: Sequence[PointTarget],
    surfaces: Sequence[SurfaceTarget],
    settings: EvaluationSettings,
) -> list[dict[str, object]]:
    kept = [other for other in range(len(targets)) if other != case]
    others = [targets[other] for other in kept]
    model = build(aligned.subset(kept))
    shapes = model.reconstruct(drawn_scores(model, weights[:, kept])[:, :modes])
    every = np.arange(points.count)
    candidates = [
        estimates(PointTarget.of(points.on(shape)), others, every)[0].argsort()[:_CANDIDATES]
        for shape in shapes
    ]
    left = [surfaces[other] for other in kept]
    found = nearest_surface(shapes, model.faces, left, candidates, settings.surface_points)
    halves = np.array_split(found[:, 0], 2)
    return [
        {
            "case_id": aligned.case_ids[case],
            "modes": modes,
            "half": number,
            "surface_mm": float(half.mean()),
        }
        for number, half in enumerate(halves)
    ]

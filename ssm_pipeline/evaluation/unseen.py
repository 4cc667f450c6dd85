"""Specificity towards cases that nothing was learned from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssm_pipeline.evaluation.aligned_cohort import AlignedCohort, moved
from ssm_pipeline.evaluation.sampling import FixedPoints
from ssm_pipeline.evaluation.settings import EvaluationSettings
from ssm_pipeline.evaluation.specificity import (
    drawn_scores,
    estimates,
    even_samples,
    nearest_surface,
)
from ssm_pipeline.geometry.distances import PointTarget, SurfaceTarget
from ssm_pipeline.records import Mesh

_CANDIDATES = 3


def unseen_specificity(
    cohort: AlignedCohort,
    held_out: np.ndarray,
    modes: int,
    settings: EvaluationSettings,
    generator: np.random.Generator,
) -> dict[str, float]:
    """How near the draws of a model of the kept cases are to the held-out ones.

    Args:
        held_out: Places of those cases that the model, and all that made the correspondences, never
            saw.

    Returns:
        Modes, draws; surface_mm, surface_se_mm: distance to the nearest held-out mesh, with its
        standard error over the draws; seen_surface_mm: to the nearest of as many of the kept ones,
        drawn at random. The nearest of few is farther away than the nearest of all, so it is these
        two that compare with each other, and not the table `specificity`.
    """
    kept = np.setdiff1d(np.arange(len(cohort.meshes)), held_out)
    model, frames = cohort.of_the_others(held_out)
    modes = min(modes, model.mode_count)
    weights = generator.standard_normal((settings.surface_samples, len(kept)))
    shapes = model.reconstruct(drawn_scores(model, weights)[:, :modes])
    points = FixedPoints.of(model.mean, model.faces, 4 * settings.screening_points, generator)
    as_many = generator.permutation(kept)[: len(held_out)]
    found = {
        name: _nearest(
            shapes,
            model.faces,
            [moved(cohort.meshes[case], frames[int(case)]) for case in cases],
            points,
            settings,
        )
        for name, cases in (("unseen", held_out), ("seen", as_many))
    }
    unseen = found["unseen"]
    return {
        "modes": modes,
        "draws": len(unseen),
        "surface_mm": float(unseen.mean()),
        "surface_se_mm": float(unseen.std(ddof=1) / np.sqrt(len(unseen))),
        "seen_surface_mm": float(found["seen"].mean()),
    }


def _nearest(
    shapes: np.ndarray,
    faces: np.ndarray,
    meshes: Sequence[Mesh],
    points: FixedPoints,
    settings: EvaluationSettings,
) -> np.ndarray:
    """(n,) surface distance of each shape to the nearest mesh."""
    generator = np.random.default_rng(0)  # where the samples of the screening lie
    targets = [PointTarget.of(even_samples(mesh, points.count, generator)) for mesh in meshes]
    every = np.arange(points.count)
    candidates = [
        estimates(PointTarget.of(points.on(shape)), targets, every)[0].argsort()[:_CANDIDATES]
        for shape in shapes
    ]
    surfaces = [SurfaceTarget.of(mesh.vertices, mesh.faces) for mesh in meshes]
    return nearest_surface(shapes, faces, surfaces, candidates, settings.surface_points)[:, 0]

"""What specificity would have been without each patient: its uncertainty over them, not over draws.

A bootstrap would hold many cases twice, and a model's draws then find a mesh that it was built on
twice: specificity of such cohorts is another quantity. Leaving one patient out at a time has no
such fault, and asks for as many models only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import joblib
import numpy as np
import pandas as pd

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
from ssm_pipeline.parallel import in_processes

_CANDIDATES = 3  # meshes nearest by Chamfer of a few points, compared by surface distance


@dataclass(frozen=True, eq=False)
class _Draws:
    """What is the same whoever is left out.

    Attributes:
        weights: (n, N) of the cases in each draw.
        points: Where a draw is looked at.
        samples: Of each mesh, as many.
        modes: Of each model.
    """

    weights: np.ndarray
    points: FixedPoints
    samples: Sequence[np.ndarray]
    modes: int


def without_each(
    cohort: AlignedCohort,
    modes: int,
    settings: EvaluationSettings,
    generator: np.random.Generator,
    jobs: int = 1,
    patients: Sequence[str] | None = None,
) -> pd.DataFrame:
    """Specificity of the models built without each patient, by surface distance to the meshes left.

    Args:
        modes: Of each model, at most as many as the smallest has.
        patients: (N,) whom each case is of; None: each its own.

    Returns:
        Two rows for each, one for each half of the draws: left_out (the patient; its case's id
        where none is known), modes, half, surface_mm (the mean over the draws). The weights of the
        draws are the same for every one left out and every method, so that only what it changes is
        seen.
    """
    shapes = cohort.shapes
    count = len(shapes.case_ids)
    weights = generator.standard_normal((settings.jackknife_samples, count))
    mean = shapes.vertices.mean(axis=0)
    points = FixedPoints.of(mean, shapes.faces, settings.screening_points, generator)
    samples = [even_samples(mesh, points.count, generator) for mesh in cohort.meshes]
    draws = _Draws(weights, points, samples, modes)
    whose = np.array(shapes.case_ids if patients is None else patients)
    names = list(dict.fromkeys(whose.tolist()))
    tasks = [
        joblib.delayed(_without_some)(cohort, whose, part.tolist(), draws, settings.surface_points)
        for part in np.array_split(np.array(names), min(jobs, len(names)))
    ]
    return pd.DataFrame([row for part in in_processes(tasks, jobs) for row in part])


def _without_some(
    cohort: AlignedCohort,
    whose: np.ndarray,
    names: Sequence[str],
    draws: _Draws,
    surface_points: int,
) -> list[dict[str, object]]:
    """The rows of some of the patients."""
    every = np.arange(draws.points.count)
    rows: list[dict[str, object]] = []
    for name in names:
        kept = np.flatnonzero(whose != name).tolist()
        model, frames = cohort.of_the_others(np.flatnonzero(whose == name))
        others = [PointTarget.of(frames[case].apply(draws.samples[case])) for case in kept]
        scores = drawn_scores(model, draws.weights[:, kept])[:, : draws.modes]
        shapes = model.reconstruct(scores)
        ranked = (
            estimates(PointTarget.of(draws.points.on(shape)), others, every)[0].argsort()
            for shape in shapes
        )
        candidates = [nearest[:_CANDIDATES] for nearest in ranked]
        surfaces = {}
        for place in np.unique(np.concatenate(candidates)).tolist():
            mesh = moved(cohort.meshes[kept[place]], frames[kept[place]])
            surfaces[place] = SurfaceTarget.of(mesh.vertices, mesh.faces)
        found = nearest_surface(shapes, model.faces, surfaces, candidates, surface_points)
        rows += [
            {
                "left_out": name,
                "modes": draws.modes,
                "half": number,
                "surface_mm": float(half.mean()),
            }
            for number, half in enumerate(np.array_split(found[:, 0], 2))
        ]
    return rows

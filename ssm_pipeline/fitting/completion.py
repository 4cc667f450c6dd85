"""How uncertain is each vertex of a fit, and of the part that was not seen most of all?

What the scores leave open is the model's own answer, and too sure: a model of twenty cases has no
mode for much of what a new case does. So the model's cases are fitted as the patient is, without
being in the model, and, where a part of the patient is missing, cut as it is: how far they end from
their own surfaces says how far the patient's may lie.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed

from ssm_pipeline.fitting.cross_validation import (
    LeftOutFits,
    model_without,
    of_common_modes,
    score_inflation,
)
from ssm_pipeline.fitting.model_fit import Fit, fit, normal_variance
from ssm_pipeline.fitting.partial import without_faces
from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.geometry.distances import SurfaceTarget
from ssm_pipeline.records import CorrespondedShapes, Mesh
from ssm_pipeline.shape_model.model import ShapeModel

COVERAGE = 0.90
# Of the fits to the model's cut cases: fewer than the patient's, since they are many.
POINTS, STEPS = 300, 25


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """sd_mm (V,): of each vertex along its normal; radius_mm (V,): the surface is expected within
    it of the vertex for a share `COVERAGE` of the vertices, by the model's own cases.

    score_inflation: by how much the posterior's standard deviations of scores are too small.
    """

    sd_mm: np.ndarray
    radius_mm: np.ndarray
    score_inflation: float


def uncertainty(model: ShapeModel, fitted: Fit, left_out: LeftOutFits) -> Uncertainty:
    """Of a fit, by fits of the same kind to the model's own cases.

    The variance of a vertex is what the posterior leaves open plus what the cases' errors exceed
    that by. The radius is as many of its standard deviations as hold 90 % of the errors on the part
    that was not seen, or on all of it, where all was.

    A case's vertices are wrong together, so that it is the N cases that are exchangeable with the
    patient, and not their N × V errors: the patient counts as one case more, whose errors may be
    anything, and (N + 1) / N of 90 % of the cases' have to be held. Fewer than nine cases can't
    promise that; their largest error is taken then.
    Source: hierarchical conformal prediction (Lee, Barber and Willett 2023, eq. 5).
    """
    errors, own = left_out.distances_mm, left_out.stated_mm2
    wanted = ~fitted.observed if fitted.is_partial else fitted.observed
    sd = np.sqrt(normal_variance(model, fitted) + _excess(errors, own))
    ratios = [
        # Each case by the others' errors, as the patient is by all of them.
        errors[index] / np.sqrt(own[index] + _excess(*_without(index, errors, own)))
        for index in range(len(errors))
    ]
    level = min(1.0, COVERAGE * (1 + 1 / len(errors)))
    times = float(np.quantile(np.stack(ratios)[:, wanted], level))
    return Uncertainty(sd, times * sd, score_inflation(left_out.score_errors))


def fits_of_parts(
    shapes: CorrespondedShapes,
    meshes: Sequence[Mesh],
    observed: np.ndarray,
    with_scale: bool = False,
    seed: int = 0,
    jobs: int = 1,
) -> LeftOutFits:
    """The model's cases, each fitted where it is `observed` (V,) alone, by the others' model.

    shapes  as matched, each in its own millimetres; meshes: in the same order.
    """
    work = Parallel(n_jobs=jobs)(
        delayed(_completed_without)(shapes, index, mesh, observed, with_scale, seed)
        for index, mesh in enumerate(meshes)
    )
    distances, stated = (np.stack([case[part] for case in work]) for part in (0, 1))
    return LeftOutFits(distances, stated, of_common_modes([case[2] for case in work]))


def cut_as_observed(mesh: Mesh, matched: Mesh, observed: np.ndarray) -> Mesh:
    """The part of a case's mesh that lies nearest to the observed vertices (V,) bool of the
    template as matched to it."""
    unseen = ~observed[matched.faces].all(axis=1)
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    gone = unseen[closest_points(middles, matched.vertices, matched.faces).faces]
    return without_faces(mesh, gone) if gone.any() else mesh


def _excess(errors: np.ndarray, own: np.ndarray) -> np.ndarray:
    """(V,) mm²: by how much the errors (N, V) exceed the variances (N, V) stated for them."""
    return np.maximum((errors**2).mean(axis=0) - own.mean(axis=0), 0) + 1e-6


def _without(index: int, *arrays: np.ndarray) -> list[np.ndarray]:
    return [np.delete(array, index, axis=0) for array in arrays]


def _completed_without(
    shapes: CorrespondedShapes,
    index: int,
    mesh: Mesh,
    observed: np.ndarray,
    with_scale: bool,
    seed: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of one case: distances (V,) mm, variances stated (V,) mm², errors of the scores (M,)."""
    model, start = model_without(shapes, index, with_scale)
    matched = Mesh(shapes.vertices[index], shapes.faces, shapes.case_ids[index])
    part = cut_as_observed(mesh, matched, observed)
    fitted = fit(model, part, start, with_scale, points=POINTS, steps=STEPS, seed=seed)
    distances = SurfaceTarget.of(mesh.vertices, mesh.faces).distances_to(fitted.vertices)
    true = model.coefficients(start.inverse().apply(matched.vertices))
    return distances, normal_variance(model, fitted), (fitted.scores - true) / fitted.score_sd

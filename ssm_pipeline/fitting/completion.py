"""How uncertain is each vertex of a fit, and of the part that was not seen most of all?

What the scores leave open is the model's own answer, and too sure: a model of twenty cases has no
mode for much of what a new case does. So the model's cases are cut as the patient is, completed
without being in the model, and compared with what was cut off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed

from ssm_pipeline.fitting.cross_validation import (
    model_without,
    of_common_modes,
    score_inflation,
)
from ssm_pipeline.fitting.model_fit import Fit, fit
from ssm_pipeline.fitting.partial import without_faces
from ssm_pipeline.geometry.distances import SurfaceTarget
from ssm_pipeline.geometry.surface import vertex_normals
from ssm_pipeline.records import CorrespondedShapes, Mesh
from ssm_pipeline.shape_model.model import ShapeModel

COVERAGE = 0.90
# Of the fits to the model's cases: fewer than the patient's, since they are many.
POINTS, STEPS = 300, 25


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """sd_mm (V,): of each vertex along its normal; radius_mm (V,): the surface passes within it of
    the vertex for a share `COVERAGE` of the vertices, by the model's own cases.

    score_inflation: by how much the posterior's standard deviations of scores are too small.
    """

    sd_mm: np.ndarray
    radius_mm: np.ndarray
    score_inflation: float


def normal_variance(model: ShapeModel, fitted: Fit) -> np.ndarray:
    """(V,) mm², in the surface's own: what the posterior of the scores leaves open, along the
    normals of the fitted vertices."""
    normals = vertex_normals(model.reconstruct(fitted.scores), model.faces)
    along = np.einsum("mvd,vd->vm", model.modes, normals) * model.standard_deviations
    return fitted.frame.scale**2 * np.einsum("vm,mn,vn->v", along, fitted.covariance, along)


def uncertainty(
    model: ShapeModel,
    fitted: Fit,
    shapes: CorrespondedShapes,
    with_scale: bool = False,
    seed: int = 0,
    jobs: int = 1,
) -> Uncertainty:
    """Of a fit to a surface of which a part is missing.

    shapes  the model's cases as matched, each in its own millimetres.
    The variance of a vertex is what the posterior leaves open plus what the cases' errors exceed
    that by; the radius is as many of its standard deviations as hold 90 % of the errors on the
    part not seen (on all of it, where all was seen).
    Source: split conformal prediction (Lei et al. 2018), the scores pooled over vertices.
    """
    work = Parallel(n_jobs=jobs)(
        delayed(_completed_without)(shapes, index, fitted.observed, with_scale, seed)
        for index in range(len(shapes.case_ids))
    )
    errors, own = (np.stack([case[part] for case in work]) for part in (0, 1))
    z = of_common_modes([case[2] for case in work])
    wanted = ~fitted.observed if fitted.is_partial else fitted.observed
    stated = normal_variance(model, fitted)
    sd = np.sqrt(stated + _excess(errors, own))
    ratios = [
        # Each case by the others' errors, as the patient is by all of them.
        np.abs(errors[index]) / np.sqrt(own[index] + _excess(*_without(index, errors, own)))
        for index in range(len(errors))
    ]
    times = float(np.quantile(np.stack(ratios)[:, wanted], COVERAGE))
    return Uncertainty(sd, times * sd, score_inflation(z))


def _excess(errors: np.ndarray, own: np.ndarray) -> np.ndarray:
    """(V,) mm²: by how much the errors (N, V) exceed the variances (N, V) stated for them."""
    return np.maximum((errors**2).mean(axis=0) - own.mean(axis=0), 0) + 1e-6


def _without(index: int, *arrays: np.ndarray) -> list[np.ndarray]:
    return [np.delete(array, index, axis=0) for array in arrays]


def _completed_without(
    shapes: CorrespondedShapes, index: int, observed: np.ndarray, with_scale: bool, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A case's errors (V,) mm when only `observed` (V,) of it is fitted by the others' model: from
    each vertex to the case's surface; the variances (V,) mm² stated; the scores' errors (M,) in
    standard deviations stated."""
    model, start = model_without(shapes, index, with_scale)
    whole = Mesh(shapes.vertices[index], shapes.faces, shapes.case_ids[index])
    unseen = ~observed[shapes.faces].all(axis=1)
    part = without_faces(whole, unseen) if unseen.any() else whole
    fitted = fit(model, part, start, with_scale, points=POINTS, steps=STEPS, seed=seed)
    distances = SurfaceTarget.of(whole.vertices, whole.faces).distances_to(fitted.vertices)
    true = model.coefficients(start.inverse().apply(whole.vertices))
    return distances, normal_variance(model, fitted), (fitted.scores - true) / fitted.score_sd

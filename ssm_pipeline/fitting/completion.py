"""How uncertain is each vertex of a fit, and of the part that was not seen most of all?

What the scores leave open is the model's own answer, and too sure: a model of twenty cases has no
mode for much of what a new case does. So the model's cases are fitted as the patient is, without
being in the model, and, where a part of the patient is missing, cut as it is: how far they end from
their own surfaces says how far the patient's may lie.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import joblib
import numpy as np
from scipy.stats import norm

from ssm_pipeline.fitting.cross_validation import (
    LeftOutFits,
    model_without,
    of_common_modes,
    score_inflation,
)
from ssm_pipeline.fitting.model_fit import Fit, fit_model, surface_variance
from ssm_pipeline.fitting.partial import without_faces
from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.geometry.distances import SurfaceTarget
from ssm_pipeline.parallel import in_processes
from ssm_pipeline.records import CorrespondedShapes, Mesh
from ssm_pipeline.shape_model.model import ShapeModel

COVERAGE = 0.90
# Of the fits to the model's cut cases: fewer than the patient's, since they are many.
POINTS, STEPS = 300, 25


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """radius_mm (V,): a share `COVERAGE` of the vertices is expected to have the surface within it,
    by the model's own cases; sd_mm (V,): the standard deviation along the normal which that is of,
    were errors normal.

    score_inflation: by how much the posterior's standard deviations of scores are too small.
    """

    radius_mm: np.ndarray
    score_inflation: float

    @property
    def sd_mm(self) -> np.ndarray:
        return self.radius_mm / float(norm.isf((1 - COVERAGE) / 2))


def uncertainty(model: ShapeModel, fitted: Fit, left_out: LeftOutFits) -> Uncertainty:
    """Of a fit, by fits of the same kind to the model's own cases."""
    radius = calibrated_radius(surface_variance(model, fitted), left_out, fitted.observed)
    return Uncertainty(radius, score_inflation(left_out.score_errors))


def calibrated_radius(
    stated_mm2: np.ndarray, left_out: LeftOutFits, observed: np.ndarray
) -> np.ndarray:
    """(V,) mm, from the variances (V,) that a fit states.

    As many of the stated standard deviations as held 90 % of the cases' errors, found for the
    vertices that were seen and for those that were not. The stated variance carries what differs
    from patient to patient: a fit that leaves more open, or more over, is less sure everywhere.
    So 90 % is the mean over patients. In one of them neighbouring vertices are wrong together, and
    the share varies.
    Source: conformal prediction, locally weighted (Lei et al. 2018, section 5.2), in two groups.
    """
    sd = np.sqrt(stated_mm2)
    ratios = left_out.distances_mm / np.sqrt(left_out.stated_mm2)
    radius = np.zeros_like(sd)
    for group in (observed, ~observed):
        if group.any():
            radius[group] = np.quantile(ratios[:, group], COVERAGE) * sd[group]
    result: np.ndarray = radius
    return result


def fits_of_parts(
    shapes: CorrespondedShapes,
    meshes: Sequence[Mesh],
    observed: np.ndarray,
    with_scale: bool = False,
    seed: int = 0,
    jobs: int = 1,
    patients: Sequence[str] | None = None,
) -> LeftOutFits:
    """The model's cases, each fitted where it is `observed` (V,) alone, by the others' model.

    Args:
        shapes: As matched, each in its own millimetres.
        meshes: In the same order.
        patients: As `cross_validate` takes them.
    """
    patients = shapes.case_ids if patients is None else patients
    tasks = (
        joblib.delayed(_completed_without)(
            shapes, index, mesh, observed, with_scale, seed, patients
        )
        for index, mesh in enumerate(meshes)
    )
    work = list(in_processes(tasks, jobs))
    distances, stated = (np.stack([case[part] for case in work]) for part in (0, 1))
    return LeftOutFits(distances, stated, of_common_modes([case[2] for case in work]))


def cut_as_observed(mesh: Mesh, matched: Mesh, observed: np.ndarray) -> Mesh:
    """The part of a case's mesh that lies nearest to the observed vertices (V,) bool of the
    template as matched to it."""
    unseen = ~observed[matched.faces].all(axis=1)
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    gone = unseen[closest_points(middles, matched.vertices, matched.faces).faces]
    return without_faces(mesh, gone) if gone.any() else mesh


def _completed_without(
    shapes: CorrespondedShapes,
    index: int,
    mesh: Mesh,
    observed: np.ndarray,
    with_scale: bool,
    seed: int,
    patients: Sequence[str],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of one case: distances (V,) mm, variances stated (V,) mm², errors of the scores (M,)."""
    model, start = model_without(shapes, index, with_scale, patients)
    matched = Mesh(shapes.vertices[index], shapes.faces, shapes.case_ids[index])
    part = cut_as_observed(mesh, matched, observed)
    fitted = fit_model(model, part, start, with_scale, points=POINTS, steps=STEPS, seed=seed)
    distances = SurfaceTarget.of(mesh.vertices, mesh.faces).distances_to(fitted.vertices)
    true = model.coefficients(start.inverse().apply(matched.vertices))
    return distances, surface_variance(model, fitted), (fitted.scores - true) / fitted.score_sd

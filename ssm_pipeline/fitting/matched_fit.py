"""A patient whose surface is matched to the template already: pose and scores of its points."""

from __future__ import annotations

import numpy as np

from ssm_pipeline.fitting.model_fit import CORRELATION_POINTS, Fit
from ssm_pipeline.fitting.observations import independent_observations
from ssm_pipeline.geometry.distances import SurfaceTarget
from ssm_pipeline.geometry.rigid import best_similarity
from ssm_pipeline.geometry.surface import area, vertex_normals
from ssm_pipeline.records import Mesh
from ssm_pipeline.shape_model.model import ShapeModel

STEPS = 50


def fit_points(
    model: ShapeModel, points: np.ndarray, surface: Mesh, with_scale: bool = False
) -> Fit:
    """The most probable instance of the model for corresponding points (V, 3) mm, and its pose.

    Modes are orthonormal, so that each score is shrunk alone: by λ / (λ + σ² V / n), with the
    noise σ of what no mode can make, and the n independent observations that the V points are
    worth.
    """
    scores, noise = np.zeros(model.mode_count), 0.0
    observations = float(len(points))
    size = area(model.mean, model.faces)
    chosen = slice(None, None, max(1, len(points) // CORRELATION_POINTS))
    shrink = np.ones(model.mode_count)
    for _ in range(STEPS):
        instance = model.reconstruct(scores)
        frame = best_similarity(instance, points, with_scale=with_scale)
        there = frame.inverse().apply(points)
        rest = there - model.project(there)
        noise = float(np.sqrt((rest**2).mean())) + 1e-9
        along = np.einsum("vd,vd->v", rest, vertex_normals(instance, model.faces))
        observations = independent_observations(instance[chosen], along[chosen], size)
        shrink = model.variances / (model.variances + noise**2 * len(points) / observations)
        new = shrink * model.coefficients(there)
        change, scores = np.abs(new - scores).max(), new
        if change < 1e-6:
            break
    vertices = frame.apply(model.reconstruct(scores))
    return Fit(
        scores=scores,
        covariance=np.diag(1 - shrink),
        vertices=vertices,
        frame=frame,
        observed=np.ones(len(points), dtype=bool),
        distances_mm=SurfaceTarget.of(surface.vertices, surface.faces).distances_to(vertices),
        noise_mm=noise,
        observations=observations,
    )

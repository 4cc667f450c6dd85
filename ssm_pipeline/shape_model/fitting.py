"""Fit a shape model to a new surface that has no correspondence yet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.geometry.rigid import best_similarity, iterative_closest_point
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.geometry.surface import sample_points
from ssm_pipeline.records import Mesh
from ssm_pipeline.shape_model.model import ShapeModel


@dataclass(frozen=True, eq=False)
class Fit:
    """scores (M,) standard deviations; vertices (V, 3) mm: the model's instance, in the surface's
    own space; frame: model space → the surface's; distances_mm (V,) instance → surface.
    """

    scores: np.ndarray
    vertices: np.ndarray
    frame: Similarity
    distances_mm: np.ndarray


def fit(
    model: ShapeModel,
    surface: Mesh,
    noise_mm: float = 1.0,
    steps: int = 60,
    tolerance: float = 1e-4,
) -> Fit:
    """The most probable instance of the model on a surface, and its pose.

    Alternates: the surface's nearest point to every vertex, the rigid pose of these, and the scores
    that are most probable if each point is off by `noise_mm` (posterior mean of probabilistic PCA).
    Starts with the mean laid on the surface by iterative closest points, so the surface must lie
    the way the model's cases do, to about 40 degrees.
    Source: Cootes 1995 (active shape models); Albrecht et al. 2013 for the posterior.
    """
    generator = np.random.default_rng(0)
    frame = iterative_closest_point(
        sample_points(model.mean, model.faces, 4000, generator),
        sample_points(surface.vertices, surface.faces, 4000, generator),
    )
    modes = model.modes.reshape(model.mode_count, -1)
    # Modes are orthonormal: the posterior's covariance is diagonal, each score shrinks alone.
    shrink = model.variances / (model.variances + noise_mm**2)
    instance, scores = model.mean, np.zeros(model.mode_count)
    for _ in range(steps):
        found = closest_points(frame.apply(instance), surface.vertices, surface.faces).points
        frame = best_similarity(instance, found)
        offset = (frame.inverse().apply(found) - model.mean).ravel()
        new = shrink * (modes @ offset) / model.standard_deviations
        change = np.abs(new - scores).max()
        scores, instance = new, model.reconstruct(new)
        if change < tolerance:
            break
    vertices = frame.apply(instance)
    distances = closest_points(vertices, surface.vertices, surface.faces).distances
    return Fit(scores, vertices, frame, distances)

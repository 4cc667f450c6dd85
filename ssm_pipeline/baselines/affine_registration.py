"""Affine alignment of a template to a case."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ssm_pipeline.baselines.settings import RegistrationSettings
from ssm_pipeline.geometry.barycentric import interpolated
from ssm_pipeline.geometry.surface import sample_points, sample_surface
from ssm_pipeline.records import Mesh


def affinely_aligned(
    start: np.ndarray, faces: np.ndarray, case: Mesh, settings: RegistrationSettings, seed: int
) -> np.ndarray:
    """(V, 3) mm: a template placed on the case, start (V, 3), moved by the best affine map.

    Iterative closest points, matched both ways so that neither surface can shrink into the other.
    """
    generator = np.random.default_rng(seed)
    face, weights = sample_surface(start, faces, settings.affine_points, generator)
    source = interpolated(start, faces[face], weights)
    target = sample_points(case.vertices, case.faces, settings.affine_points, generator)
    target_tree = cKDTree(target)
    affine, previous = np.vstack([np.eye(3), np.zeros(3)]), np.inf
    for _ in range(settings.affine_steps):
        moved = _with_one(source) @ affine
        to_target, nearest_target = target_tree.query(moved)
        to_source, nearest_source = cKDTree(moved).query(target)
        error = float((to_target**2).mean() + (to_source**2).mean())
        if previous - error <= 1e-6 * error:
            break
        previous = error
        affine = np.linalg.lstsq(
            _with_one(np.concatenate([source, source[nearest_source]])),
            np.concatenate([target[nearest_target], target]),
            rcond=None,
        )[0]
    return _with_one(start) @ affine


def _with_one(points: np.ndarray) -> np.ndarray:
    return np.column_stack([points, np.ones(len(points))])

"""Rigid and similarity alignment of point sets, with and without known correspondence."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ssm_pipeline.geometry.similarity import Similarity


def best_similarity(
    source: np.ndarray,
    target: np.ndarray,
    weights: np.ndarray | None = None,
    with_scale: bool = False,
) -> Similarity:
    """The rigid (or similarity) motion that takes source (V, 3) closest to target (V, 3).

    Least squares in closed form, rotation with determinant +1. Source: Umeyama 1991.
    """
    w = np.full(len(source), 1 / len(source)) if weights is None else weights / weights.sum()
    source_mean, target_mean = w @ source, w @ target
    source_c, target_c = source - source_mean, target - target_mean
    U, S, Vt = np.linalg.svd((target_c * w[:, None]).T @ source_c)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    rotation = (U * signs) @ Vt
    scale = (S @ signs) / (w @ (source_c**2).sum(axis=1)) if with_scale else 1.0
    return Similarity(float(scale), rotation, target_mean - scale * rotation @ source_mean)


def iterative_closest_point(
    source: np.ndarray,
    target: np.ndarray,
    start: Similarity | None = None,
    steps: int = 60,
    tolerance: float = 1e-6,
    with_scale: bool = False,
) -> Similarity:
    """Rigid motion of source (S, 3) onto target (Q, 3), both evenly sampled surfaces.

    Starts with the centroids on each other unless `start` is given; matches both ways, so that
    neither surface can hide in the other. Ends where a step lowers the mean squared distance by
    less than `tolerance` of itself, after `steps` at the latest: on smooth surfaces the last of it
    falls slowly, and what follows the alignment moves more than is left. Source: Besl and McKay
    1992.
    """
    frame = start or Similarity(1.0, np.eye(3), target.mean(axis=0) - source.mean(axis=0))
    target_tree = cKDTree(target)
    previous = np.inf
    for _ in range(steps):
        moved = frame.apply(source)
        to_target, nearest_target = target_tree.query(moved, workers=-1)
        to_source, nearest_source = cKDTree(moved).query(target, workers=-1)
        error = float((to_target**2).mean() + (to_source**2).mean())
        if previous - error <= tolerance * error:
            break
        previous = error
        frame = best_similarity(
            np.concatenate([source, source[nearest_source]]),
            np.concatenate([target[nearest_target], target]),
            with_scale=with_scale,
        )
    return frame

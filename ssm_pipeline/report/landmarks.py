"""Landmarks placed on the template, transferred to every case by correspondence."""

from __future__ import annotations

import numpy as np

from ssm_pipeline.geometry.barycentric import interpolated
from ssm_pipeline.geometry.closest_point import closest_points


def carry_landmarks(
    positions: np.ndarray, template: np.ndarray, faces: np.ndarray, shapes: np.ndarray
) -> np.ndarray:
    """The same anatomical points on every corresponded shape.

    positions (L, 3) on or near the template; template (V, 3); shapes (N, V, 3); one unit for all.

    Returns:
        (N, L, 3): each landmark keeps its triangle and its place inside it.
    """
    nearest = closest_points(positions, template, faces)
    return interpolated(shapes, faces[nearest.faces], nearest.barycentric)

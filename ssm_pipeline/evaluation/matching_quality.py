"""How good a map between two shapes is, where the truth is known; and how good an interpolation."""

from __future__ import annotations

import numpy as np
import pandas as pd

from ssm_pipeline.geometry.distances import PointTarget, chamfer
from ssm_pipeline.geometry.surface import sample_points

PCK_LIMIT = 0.1  # of √area: the range most shape-matching papers plot and integrate over


def geodesic_errors(
    predicted: np.ndarray, truth: np.ndarray, distances: np.ndarray, area: float
) -> np.ndarray:
    """Geodesic distance of each predicted match from the true one, over √area.

    predicted, truth  (Q,) vertices of the target shape.
    distances         (V, V) its geodesics (`geometry.geodesics.geodesic_matrix`).
    Returns           (Q,); the usual "mean geodesic error ×100" is 100 times the mean.
    Source: Kim, Lipman and Funkhouser 2011.
    """
    return distances[predicted, truth] / np.sqrt(area)


def pck_curve(errors: np.ndarray, limit: float = PCK_LIMIT, steps: int = 100) -> pd.DataFrame:
    """Share of correct points at each threshold: threshold (over √area), share (0 … 1)."""
    thresholds = np.linspace(0, limit, steps + 1)
    ordered = np.sort(errors)
    # Errors that are equal to a threshold count as correct: at 0, the exact matches.
    share = np.searchsorted(ordered, thresholds, side="right") / len(ordered)
    return pd.DataFrame({"threshold": thresholds, "share": share})


def area_under_curve(errors: np.ndarray, limit: float = PCK_LIMIT) -> float:
    """Area under the PCK curve over its range: 1 for a perfect map.

    In closed form, free of the curve's steps: ∫₀ˡ share = mean of max(0, l − error).
    """
    return float(np.maximum(0, limit - errors).mean() / limit)


def conformal_distortion(rest: np.ndarray, moved: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F,) σ₁/σ₂ + σ₂/σ₁ of each triangle's linear map from rest (V, 3) to moved (V, 3).

    2 where angles are kept, whatever the size; inf where a triangle collapses.
    Source: Hormann and Greiner 2000 (MIPS).
    """
    first, second = _edges_in_plane(rest, faces), _edges_in_plane(moved, faces)
    jacobian = second @ np.linalg.inv(first)
    frobenius = (jacobian**2).sum(axis=(1, 2))  # σ₁² + σ₂²
    determinant = np.abs(np.linalg.det(jacobian))  # σ₁ σ₂
    ratio = np.full(len(faces), np.inf)
    np.divide(frobenius, determinant, out=ratio, where=determinant > 1e-12 * frobenius)
    return ratio


def end_chamfer(
    interpolated: np.ndarray,
    interpolated_faces: np.ndarray,
    target: np.ndarray,
    target_faces: np.ndarray,
    points: int,
    generator: np.random.Generator,
) -> float:
    """Chamfer distance between X(1) and Y, `points` samples each, in the vertices' unit."""
    return chamfer(
        PointTarget.of(sample_points(interpolated, interpolated_faces, points, generator)),
        PointTarget.of(sample_points(target, target_faces, points, generator)),
    )


def _edges_in_plane(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F, 2, 2) each triangle's two edges as columns, in coordinates of its own plane."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    base, side = b - a, c - a
    length = np.linalg.norm(base, axis=1)
    along = np.einsum("fd,fd->f", base, side) / length
    height = np.linalg.norm(np.cross(base, side), axis=1) / length
    zero = np.zeros_like(length)
    return np.stack([np.stack([length, zero], axis=1), np.stack([along, height], axis=1)], axis=2)

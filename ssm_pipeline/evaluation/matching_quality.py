"""How good a map between two shapes is, where the truth is known."""

from __future__ import annotations

import numpy as np
import pandas as pd

PCK_LIMIT = 0.1  # of √area: the range most shape-matching papers plot and integrate over


def geodesic_errors(
    predicted: np.ndarray, truth: np.ndarray, distances: np.ndarray, area: float
) -> np.ndarray:
    """Geodesic distance of each predicted match from the true one, over √area.

    Args:
        predicted, truth: (Q,) vertices of the target shape.
        distances: (V, V) its geodesics (`geometry.geodesics.geodesic_matrix`).

    Returns:
        (Q,); the usual "mean geodesic error ×100" is 100 times the mean.

    Source: Kim, Lipman and Funkhouser 2011.
    """
    result: np.ndarray = distances[predicted, truth] / np.sqrt(area)
    return result


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
    # Σ cot α_i |e_i|² over twice the moved area, α_i the rest triangle's angles.
    cosines, rest_area, _ = _corners(rest, faces)
    _, moved_area, squared = _corners(moved, faces)
    ratio = np.full(len(faces), np.inf)
    energy = (cosines * squared).sum(axis=1)
    area_product = rest_area * moved_area
    has_area = area_product > 1e-12 * np.abs(energy)
    np.divide(energy, area_product, out=ratio, where=has_area)
    return ratio


def _corners(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(F, 3) the product of the two edges at each corner, (F,) twice the area, and (F, 3) the
    squared length of the edge opposite to each corner."""
    corners = vertices[faces]
    to_next, to_last = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    products = np.einsum("fcd,fcd->fc", to_next, to_last)
    twice_area = np.linalg.norm(np.cross(to_next[:, 0], to_last[:, 0]), axis=1)
    return products, twice_area, ((to_last - to_next) ** 2).sum(axis=2)

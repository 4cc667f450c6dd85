"""The spatial loss: alignment, rigidity, symmetry and variance along the interpolation."""

from __future__ import annotations

from collections.abc import Callable

import torch

from ssm_pipeline.interpolation.arap import arap_energy
from ssm_pipeline.interpolation.interpolator import Interpolator
from ssm_pipeline.interpolation.settings import SpatialLossSettings
from ssm_pipeline.matching.pair import MatchedPair
from ssm_pipeline.matching.shape import Shape

# On equilateral triangles every cotangent weight is 1/√3: with this factor the weighted energy is
# there Eq. 12's, whose edges all weigh 1.
COTANGENT_TO_UNIFORM = 3**0.5

# Shape X, its poses X_0 … X_T, and Y_T … Y_0 carried to it → a term of one direction.
Term = Callable[[Shape, torch.Tensor, torch.Tensor, SpatialLossSettings], torch.Tensor]


def spatial_loss(
    pair: MatchedPair, interpolator: Interpolator, intervals: int, settings: SpatialLossSettings
) -> dict[str, torch.Tensor]:
    """The terms, weighted, both directions added. `intervals` is T ≥ 1: times 0, 1/T … 1.

    No terms, and no work, where all weights are 0: the ablation without interpolation.
    Source: Cao et al. 2024, Eq. 9–13; differs: norms over vertices are weighted by area, and see
    SpatialLossSettings.
    """
    if settings.is_none:
        return {}
    T, x, y = intervals, pair.shape_x, pair.shape_y
    times = torch.arange(1, T + 1, dtype=x.vertices.dtype, device=x.vertices.device) / T
    X = torch.cat([x.vertices[None], interpolator(x.vertices, pair.y_on_x, times, x.neighbours)])
    Y = torch.cat([y.vertices[None], interpolator(y.vertices, pair.x_on_y, times, y.neighbours)])
    # Y_T … Y_0 carried to X, and X_T … X_0 to Y: entry k stands beside X_k.
    on_x, on_y = pair.carry(_columns(X[1:]), _columns(Y[1:]))
    Y_on_x = torch.cat([_times(on_x).flip(0), pair.y_on_x[None]])
    X_on_y = torch.cat([_times(on_y).flip(0), pair.x_on_y[None]])

    def both(term: Term) -> torch.Tensor:
        return term(x, X, Y_on_x, settings) + term(y, Y, X_on_y, settings)

    return {
        "align": settings.align * both(_align),
        "arap": settings.arap * both(_arap),
        "symmetry": settings.symmetry * both(_symmetry),
        "variance": settings.variance * both(_variance),
        "dirichlet": settings.dirichlet * both(_dirichlet),
    }


def _align(
    shape: Shape, X: torch.Tensor, Y_on_x: torch.Tensor, settings: SpatialLossSettings
) -> torch.Tensor:
    """‖X − Π Y(1)‖², or as printed ‖X(1) − Π Y‖²."""
    moment = 0 if settings.align_form == "cycle" else -1
    return _squared(shape, X[moment] - Y_on_x[moment], settings)


def _arap(
    shape: Shape, X: torch.Tensor, Y_on_x: torch.Tensor, settings: SpatialLossSettings
) -> torch.Tensor:
    """Σ_{k=0}^{T−1} E_arap(X_k, X_{k+1})."""
    weights = torch.ones_like(shape.edge_weights)
    if settings.arap_edges == "cotangent":
        weights = COTANGENT_TO_UNIFORM * shape.edge_weights
    energy = arap_energy(X[:-1], X[1:], shape.edges, weights).sum()
    if settings.arap_both_ways:
        energy = energy + arap_energy(X[1:], X[:-1], shape.edges, weights).sum()
    return energy


def _symmetry(
    shape: Shape, X: torch.Tensor, Y_on_x: torch.Tensor, settings: SpatialLossSettings
) -> torch.Tensor:
    """Σ_{k=1}^{T−1} ‖X_k − Π Y_{T−k}‖²; its mean over k where settings say so."""
    total = _squared(shape, X[1:-1] - Y_on_x[1:-1], settings)
    return total / max(len(X) - 2, 1) if settings.symmetry_mean else total


def _variance(
    shape: Shape, X: torch.Tensor, Y_on_x: torch.Tensor, settings: SpatialLossSettings
) -> torch.Tensor:
    """Σ_i Var_k ‖X_k − Π Y_{T−k}‖^i over k = 1 … T, divisor T − 1."""
    if len(X) < 3:  # T = 1: one distance has no variance
        return X.new_zeros(())
    squared = (X[1:] - Y_on_x[1:]).square().sum(-1)
    distance = (squared + 1e-12).sqrt()  # the root has no gradient at zero
    return settings.vertices * (shape.mass * distance.var(dim=0, unbiased=True)).sum()


def _dirichlet(
    shape: Shape, X: torch.Tensor, Y_on_x: torch.Tensor, settings: SpatialLossSettings
) -> torch.Tensor:
    """trace((Π Y)ᵀ L Π Y)."""
    y_on_x = Y_on_x[-1]
    return (y_on_x * (shape.laplacian @ y_on_x)).sum()


def _squared(shape: Shape, difference: torch.Tensor, settings: SpatialLossSettings) -> torch.Tensor:
    """‖difference‖², (…, V, 3), summed over vertices by area and over times."""
    return settings.vertices * (shape.mass * difference.square().sum(-1)).sum()


def _columns(poses: torch.Tensor) -> torch.Tensor:
    """(T, V, 3) → (V, 3T), what a map carries at once."""
    return poses.transpose(0, 1).flatten(1)


def _times(columns: torch.Tensor) -> torch.Tensor:
    """(V, 3T) → (T, V, 3)."""
    result: torch.Tensor = columns.unflatten(1, (-1, 3)).transpose(0, 1)
    return result

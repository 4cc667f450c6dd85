"""The spatial loss: alignment, rigidity, symmetry and variance along the interpolation."""

from __future__ import annotations

import torch

from ssm_pipeline.interpolation.arap import arap_energy
from ssm_pipeline.interpolation.interpolator import Interpolator
from ssm_pipeline.interpolation.settings import SpatialLossWeights
from ssm_pipeline.matching.settings import MatchingSettings
from ssm_pipeline.matching.shape import Shape
from ssm_pipeline.matching.soft_map import soft_maps
from ssm_pipeline.matching.spectral_loss import PairMaps


def spatial_loss(
    shape_x: Shape,
    shape_y: Shape,
    features_x: torch.Tensor,
    features_y: torch.Tensor,
    maps: PairMaps,
    interpolator: Interpolator,
    time_steps: int,
    weights: SpatialLossWeights,
    settings: MatchingSettings,
) -> dict[str, torch.Tensor]:
    """The terms, weighted, both directions added. `time_steps` is T; T = 0 aligns the end only.

    No terms, and no work, where all weights are 0: the ablation without interpolation.
    Source: Cao et al. 2024, Eq. 9–13. Norms are sums over vertices, as printed.
    """
    if weights == SpatialLossWeights.none():
        return {}
    T = max(time_steps, 1)
    times = torch.arange(1, T + 1, dtype=features_x.dtype, device=features_x.device) / T
    X = interpolator(shape_x.vertices, maps.y_on_x, times, shape_x.neighbours)
    Y = interpolator(shape_y.vertices, maps.x_on_y, times, shape_y.neighbours)
    align = (X[-1] - maps.y_on_x).square().sum() + (Y[-1] - maps.x_on_y).square().sum()
    terms = {"align": weights.align * align}
    if weights.dirichlet > 0:
        terms["dirichlet"] = weights.dirichlet * (
            (maps.y_on_x * (shape_x.stiffness @ maps.y_on_x)).sum()
            + (maps.x_on_y * (shape_y.stiffness @ maps.x_on_y)).sum()
        )
    if time_steps == 0:
        return terms

    X = torch.cat([shape_x.vertices[None], X])  # X_0 … X_T
    Y = torch.cat([shape_y.vertices[None], Y])
    arap = (
        arap_energy(X[:-1], X[1:], shape_x.edges, shape_x.edge_weights).sum()
        + arap_energy(Y[:-1], Y[1:], shape_y.edges, shape_y.edge_weights).sum()
    )
    on_x, on_y = soft_maps(
        features_x,
        features_y,
        X.transpose(0, 1).flatten(1),
        Y.transpose(0, 1).flatten(1),
        settings.temperature,
        settings.block_rows,
    )
    symmetry_x, variance_x = _symmetry_and_variance(X, on_x)
    symmetry_y, variance_y = _symmetry_and_variance(Y, on_y)
    terms["arap"] = weights.arap * arap
    terms["symmetry"] = weights.symmetry * (symmetry_x + symmetry_y)
    terms["variance"] = weights.variance * (variance_x + variance_y)
    return terms


def _symmetry_and_variance(
    X: torch.Tensor, other: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """L_sym = Σ_{k=1}^{T−1} ‖X_k − Π Y_{T−k}‖², L_var = Σ_i Var_k ‖X_k − Π Y_{T−k}‖^i.

    X (T+1, V, 3); other (V, 3(T+1)): Π applied to Y_0 … Y_T.
    """
    reversed_other = other.unflatten(1, (-1, 3)).transpose(0, 1).flip(0)
    squared = (X - reversed_other).square().sum(-1)
    distance = (squared + 1e-12).sqrt()  # the root has no gradient at zero
    return squared[1:-1].sum(), distance.var(dim=0, unbiased=False).sum()

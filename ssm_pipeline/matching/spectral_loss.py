"""The spectral loss: both functional maps of a pair, and their agreement with the soft maps."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ssm_pipeline.matching.functional_map import functional_map, resolvent_mask
from ssm_pipeline.matching.settings import MatchingSettings, SpectralLossWeights
from ssm_pipeline.matching.shape import Shape
from ssm_pipeline.matching.soft_map import soft_maps


@dataclass(frozen=True, eq=False)
class PairMaps:
    """What matching says of a pair: C_xy, C_yx (K, K); the other shape's coordinates carried
    over, y_on_x = Π_xy Y (n_x, 3) and x_on_y = Π_yx X; and the same maps written in the bases,
    P_xy = Φ_y† Π_yx Φ_x and P_yx.
    """

    C_xy: torch.Tensor
    C_yx: torch.Tensor
    P_xy: torch.Tensor
    P_yx: torch.Tensor
    y_on_x: torch.Tensor
    x_on_y: torch.Tensor


def pair_maps(
    shape_x: Shape,
    shape_y: Shape,
    features_x: torch.Tensor,
    features_y: torch.Tensor,
    settings: MatchingSettings,
) -> PairMaps:
    A, B = shape_x.projection @ features_x, shape_y.projection @ features_y
    mask = settings.resolvent_weight * resolvent_mask(
        shape_x.eigenvalues, shape_y.eigenvalues, settings.resolvent_gamma
    )
    on_x, on_y = soft_maps(
        features_x,
        features_y,
        torch.cat([shape_x.vertices, shape_x.eigenvectors], dim=1),
        torch.cat([shape_y.vertices, shape_y.eigenvectors], dim=1),
        settings.temperature,
        settings.block_rows,
    )
    return PairMaps(
        C_xy=functional_map(A, B, mask),
        C_yx=functional_map(B, A, mask.T),
        P_xy=shape_y.projection @ on_y[:, 3:],
        P_yx=shape_x.projection @ on_x[:, 3:],
        y_on_x=on_x[:, :3],
        x_on_y=on_y[:, :3],
    )


def spectral_loss(maps: PairMaps, weights: SpectralLossWeights) -> dict[str, torch.Tensor]:
    """The three terms, weighted: λ_bij L_bij, λ_orth L_orth, λ_couple L_couple.

    Source: Cao et al. 2024, Eq. 3–6 and supplement; L_orth as C_xyᵀC_xy, where the supplement
    prints C_xyᵀC_yx: orthogonality concerns one map.
    """
    C_xy, C_yx = maps.C_xy, maps.C_yx
    bijectivity = _off_identity(C_xy @ C_yx) + _off_identity(C_yx @ C_xy)
    orthogonality = _off_identity(C_xy.T @ C_xy) + _off_identity(C_yx.T @ C_yx)
    coupling = (C_xy - maps.P_xy).square().sum() + (C_yx - maps.P_yx).square().sum()
    return {
        "bijectivity": weights.bijectivity * bijectivity,
        "orthogonality": weights.orthogonality * orthogonality,
        "coupling": weights.coupling * coupling,
    }


def _off_identity(matrix: torch.Tensor) -> torch.Tensor:
    identity = torch.eye(len(matrix), dtype=matrix.dtype, device=matrix.device)
    return (matrix - identity).square().sum()

"""The spectral loss: both functional maps of a pair, and their agreement with the soft maps."""

from __future__ import annotations

import torch

from ssm_pipeline.matching.pair import MatchedPair
from ssm_pipeline.matching.settings import SpectralLossWeights


def spectral_loss(pair: MatchedPair, weights: SpectralLossWeights) -> dict[str, torch.Tensor]:
    """The three terms, weighted: λ_bij L_bij, λ_orth L_orth, λ_couple L_couple.

    Source: Cao et al. 2024, Eq. 3–6 and supplement; L_orth as C_xyᵀC_xy, where the supplement
    prints C_xyᵀC_yx: orthogonality concerns one map.
    """
    C_xy, C_yx = pair.C_xy, pair.C_yx
    bijectivity = _off_identity(C_xy @ C_yx) + _off_identity(C_yx @ C_xy)
    orthogonality = _off_identity(C_xy.T @ C_xy) + _off_identity(C_yx.T @ C_yx)
    coupling = (C_xy - pair.P_xy).square().sum() + (C_yx - pair.P_yx).square().sum()
    return {
        "bijectivity": weights.bijectivity * bijectivity,
        "orthogonality": weights.orthogonality * orthogonality,
        "coupling": weights.coupling * coupling,
    }


def _off_identity(matrix: torch.Tensor) -> torch.Tensor:
    identity = torch.eye(len(matrix), dtype=matrix.dtype, device=matrix.device)
    return (matrix - identity).square().sum()

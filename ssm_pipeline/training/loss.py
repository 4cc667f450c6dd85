"""The loss of one pair."""

from __future__ import annotations

import torch

from ssm_pipeline.interpolation.spatial_loss import spatial_loss
from ssm_pipeline.matching.pair import MatchedPair, match_pair
from ssm_pipeline.matching.shape import Shape
from ssm_pipeline.matching.spectral_loss import spectral_loss
from ssm_pipeline.training.networks import Networks
from ssm_pipeline.training.settings import TrainingSettings


def pair_loss(
    shape_x: Shape,
    shape_y: Shape,
    networks: Networks,
    intervals: int,
    settings: TrainingSettings,
) -> tuple[torch.Tensor, dict[str, torch.Tensor], MatchedPair]:
    """Total loss of a pair, its weighted terms by name, and the pair as matched.

    Args:
        intervals: T, the number of steps between X and X(1).

    Source: Cao et al. 2024, Eq. 14.
    """
    features_x, features_y = networks.features(shape_x), networks.features(shape_y)
    pair = match_pair(shape_x, shape_y, features_x, features_y, settings.matching)
    spectral = spectral_loss(pair, settings.spectral_loss)
    spatial = spatial_loss(pair, networks.interpolator, intervals, settings.spatial_loss)
    total = torch.stack([*spectral.values(), *spatial.values()]).sum()
    return total, spectral | spatial, pair

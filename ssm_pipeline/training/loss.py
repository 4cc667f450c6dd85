"""The loss of one pair."""

from __future__ import annotations

import torch

from ssm_pipeline.interpolation.interpolator import Interpolator
from ssm_pipeline.interpolation.spatial_loss import spatial_loss
from ssm_pipeline.matching.diffusion_net import FeatureNetwork
from ssm_pipeline.matching.shape import Shape
from ssm_pipeline.matching.spectral_loss import pair_maps, spectral_loss
from ssm_pipeline.training.settings import TrainingSettings


def pair_loss(
    shape_x: Shape,
    shape_y: Shape,
    feature_network: FeatureNetwork,
    interpolator: Interpolator,
    time_steps: int,
    settings: TrainingSettings,
) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    """Total loss of a pair, and its weighted terms by name. Source: Cao et al. 2024, Eq. 14."""
    features_x, features_y = feature_network(shape_x), feature_network(shape_y)
    maps = pair_maps(shape_x, shape_y, features_x, features_y, settings.matching)
    spectral = spectral_loss(maps, settings.spectral_loss)
    spatial = spatial_loss(
        shape_x,
        shape_y,
        features_x,
        features_y,
        maps,
        interpolator,
        time_steps,
        settings.spatial_loss,
        settings.matching,
    )
    total = torch.stack([*spectral.values(), *spatial.values()]).sum()
    return total, spectral | spatial

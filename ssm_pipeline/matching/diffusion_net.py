"""DiffusionNet: features of a surface that do not depend on its triangulation.

Source: Sharp, Attaiki, Crane, Ovsjanikov 2022, "DiffusionNet".
"""

from __future__ import annotations

import torch
from torch import nn

from ssm_pipeline.matching.settings import MatchingSettings
from ssm_pipeline.matching.shape import Shape, input_channels


class DiffusionBlock(nn.Module):
    """Learned diffusion, gradient features and a per-vertex MLP, around a skip connection."""

    def __init__(self, width: int, dropout: float) -> None:
        super().__init__()
        self.log_time = nn.Parameter(torch.zeros(width))
        # Diffusion times spread over the scales of a unit-area surface, from a vertex's ring
        # to the whole: equal times would make every channel see the same.
        nn.init.uniform_(self.log_time, -9.0, -2.0)
        self.real = nn.Linear(width, width, bias=False)
        self.imaginary = nn.Linear(width, width, bias=False)
        self.mlp = nn.Sequential(
            nn.Linear(3 * width, width),
            nn.ReLU(),
            nn.Dropout(dropout),
            nn.Linear(width, width),
            nn.ReLU(),
            nn.Dropout(dropout),
            nn.Linear(width, width),
        )

    def forward(self, x: torch.Tensor, shape: Shape) -> torch.Tensor:
        """(V, width) → (V, width)."""
        decay = torch.exp(-shape.eigenvalues[:, None] * self.log_time.exp()[None, :])
        diffused = shape.eigenvectors @ (decay * (shape.projection @ x))
        along_x, along_y = (shape.gradients @ diffused).chunk(2)
        # A learned complex matrix turns and scales the gradients; the product with the gradients
        # themselves does not depend on the arbitrary tangent frame.
        turned_x = self.real(along_x) - self.imaginary(along_y)
        turned_y = self.real(along_y) + self.imaginary(along_x)
        gradient_features = torch.tanh(along_x * turned_x + along_y * turned_y)
        result: torch.Tensor = x + self.mlp(torch.cat([x, diffused, gradient_features], dim=1))
        return result


class FeatureNetwork(nn.Module):
    """One network for both shapes of a pair (Siamese): inputs (V, D) → features F (V, channels)."""

    def __init__(self, settings: MatchingSettings) -> None:
        super().__init__()
        self.first = nn.Linear(input_channels(settings), settings.width)
        self.blocks = nn.ModuleList(
            DiffusionBlock(settings.width, settings.dropout) for _ in range(settings.blocks)
        )
        self.last = nn.Linear(settings.width, settings.channels)
        self.normalise = settings.normalise

    def forward(self, shape: Shape) -> torch.Tensor:
        x = self.first(shape.inputs)
        for block in self.blocks:
            x = block(x, shape)
        features = self.last(x)
        return standardised(features, shape.mass) if self.normalise else features


def standardised(features: torch.Tensor, mass: torch.Tensor) -> torch.Tensor:
    """Features (V, C) with mean 0 and variance 1 over the surface, channel by channel.

    Without it the outputs share one large common part: all cosines are near 1.
    """
    weight = (mass / mass.sum())[:, None]
    centred = features - (weight * features).sum(dim=0)
    variance = (weight * centred.square()).sum(dim=0)
    return centred / (variance + 1e-8).sqrt()

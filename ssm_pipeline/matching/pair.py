"""A pair of shapes with its features, functional maps and soft maps."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ssm_pipeline.matching.functional_map import functional_map, resolvent_mask
from ssm_pipeline.matching.settings import MatchingSettings
from ssm_pipeline.matching.shape import Shape
from ssm_pipeline.matching.soft_map import soft_maps


@dataclass(frozen=True, eq=False)
class MatchedPair:
    """Both shapes, their features, and the maps between them.

    C_xy, C_yx (K, K) functional maps; y_on_x = Π_xy Y (n_x, 3) and x_on_y = Π_yx X, the other
    shape's coordinates carried over; P_xy = Φ_y† Π_yx Φ_x and P_yx, the soft maps written in the
    bases.
    """

    shape_x: Shape
    shape_y: Shape
    features_x: torch.Tensor
    features_y: torch.Tensor
    settings: MatchingSettings
    C_xy: torch.Tensor
    C_yx: torch.Tensor
    P_xy: torch.Tensor
    P_yx: torch.Tensor
    y_on_x: torch.Tensor
    x_on_y: torch.Tensor

    def carry(
        self, values_x: torch.Tensor, values_y: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Π_xy values_y (n_x, c_y) and Π_yx values_x (n_y, c_x)."""
        return soft_maps(
            self.features_x,
            self.features_y,
            values_x,
            values_y,
            self.settings.temperature,
            self.settings.block_rows,
        )


def match_pair(
    shape_x: Shape,
    shape_y: Shape,
    features_x: torch.Tensor,
    features_y: torch.Tensor,
    settings: MatchingSettings,
) -> MatchedPair:
    """Functional maps and soft maps of two shapes from their features (n, channels)."""
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
    return MatchedPair(
        shape_x,
        shape_y,
        features_x,
        features_y,
        settings,
        C_xy=functional_map(A, B, mask),
        C_yx=functional_map(B, A, mask.T),
        P_xy=shape_y.projection @ on_y[:, 3:],
        P_yx=shape_x.projection @ on_x[:, 3:],
        y_on_x=on_x[:, :3],
        x_on_y=on_y[:, :3],
    )

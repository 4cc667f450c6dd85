"""Point-to-point maps at inference: nearest features, and these projected on the eigenbasis."""

from __future__ import annotations

import torch

from ssm_pipeline.matching.shape import Shape


def nearest_rows(queries: torch.Tensor, keys: torch.Tensor, block_rows: int = 1024) -> torch.Tensor:
    """(Q,) int: for each row of queries (Q, C) the nearest row of keys (N, C), Euclidean."""
    half_squares = 0.5 * keys.square().sum(dim=1)
    return torch.cat(
        [(block @ keys.T - half_squares).argmax(dim=1) for block in queries.split(block_rows)]
    )


def nearest_features(
    features_x: torch.Tensor, features_y: torch.Tensor, block_rows: int = 1024
) -> torch.Tensor:
    """x_to_y (n_x,): for each vertex of X the vertex of Y whose feature has the largest cosine."""
    F_x, F_y = (torch.nn.functional.normalize(F, dim=1) for F in (features_x, features_y))
    return nearest_rows(F_x, F_y, block_rows)


def projected(
    x_to_y: torch.Tensor, shape_x: Shape, shape_y: Shape, block_rows: int = 1024
) -> torch.Tensor:
    """A map (n_x,), made as smooth as a functional map is: written in the bases and read back.

    C_yx = Φ_x† Π_xy Φ_y, then the nearest rows of Φ_y to Φ_x C_yx: what in the map is noise has no
    place in the span of the eigenfunctions. Source: Ovsjanikov et al. 2012; Melzi et al. 2019
    (ZoomOut), one iteration at full size.
    """
    C_yx = shape_x.projection @ shape_y.eigenvectors[x_to_y]
    return nearest_rows(shape_x.eigenvectors @ C_yx, shape_y.eigenvectors, block_rows)

"""How sharp a soft map is. The loss does not show it: that of a collapsed map looks good."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ssm_pipeline.matching.hard_map import nearest_features
from ssm_pipeline.matching.pair import MatchedPair
from ssm_pipeline.matching.shape import Shape


@dataclass(frozen=True)
class MapHealth:
    """Four numbers that tell a sharp soft map from a collapsed one.

    Attributes:
        extent: Spread of Π_xy Y over the spread of Y: 1 for a sharp map, 0 where all is averaged.
        sharpness: Mean over rows of the largest entry of Π_xy; 1 / n_y for a uniform map.
        mean_cosine: Cosine of the features of two random points of X: 1 where all are the same.
        share_hit: Share of Y's vertices that are the nearest feature of some vertex of X.
    """

    extent: float
    sharpness: float
    mean_cosine: float
    share_hit: float


@torch.no_grad()
def map_health(
    shape_x: Shape,
    shape_y: Shape,
    features_x: torch.Tensor,
    features_y: torch.Tensor,
    temperature: float,
    rows: int = 512,
) -> MapHealth:
    """Of the map X → Y; the soft map is looked at in `rows` of its rows, evenly taken."""
    F_x, F_y = (torch.nn.functional.normalize(F, dim=1) for F in (features_x, features_y))
    count = len(F_x)
    taken = torch.linspace(0, count - 1, min(rows, count), device=F_x.device).long()
    Pi = (F_x[taken] @ F_y.T / temperature).softmax(dim=1)
    carried, weight = Pi @ shape_y.vertices, shape_x.mass[taken] / shape_x.mass[taken].sum()
    unit = shape_x.mass @ F_x / shape_x.mass.sum()
    hit = torch.unique(nearest_features(F_x, F_y))
    return MapHealth(
        extent=float(_spread(carried, weight) / _spread(shape_y.vertices, shape_y.mass)),
        sharpness=float(weight @ Pi.amax(dim=1)),
        mean_cosine=float(unit.square().sum()),
        share_hit=len(hit) / len(F_y),
    )


def map_extent(pair: MatchedPair) -> float:
    """Spread of Π_xy Y over Y's own, of all vertices."""
    return float(
        _spread(pair.y_on_x, pair.shape_x.mass) / _spread(pair.shape_y.vertices, pair.shape_y.mass)
    )


def _spread(points: torch.Tensor, mass: torch.Tensor) -> torch.Tensor:
    weight = mass / mass.sum()
    centred = points - weight @ points
    return (weight @ centred.square().sum(dim=1)).sqrt()

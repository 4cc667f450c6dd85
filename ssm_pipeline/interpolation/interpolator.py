"""Ω_γ: the network that moves one shape towards the other."""

from __future__ import annotations

from typing import Any

import torch
from torch import nn

from ssm_pipeline.interpolation.settings import InterpolationSettings


class EdgeConvBlock(nn.Module):
    """EdgeConv over the one-ring, a global maximum over vertices, and a residual MLP.

    The edge feature is relu(W_a x_i + W_b (x_j − x_i)), its maximum over j taken. Linear before
    the activation, it equals relu((W_a − W_b) x_i + max_j W_b x_j) to the last digit: every
    matrix product is per vertex and nothing is kept per edge. Source: Wang et al. 2019 (EdgeConv).
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.centre = nn.Linear(width, width)
        self.neighbour = nn.Linear(width, width, bias=False)
        self.local = nn.Linear(width, width)
        self.pooled = nn.Linear(width, width, bias=False)
        self.last = nn.Linear(width, width)

    def forward(self, x: torch.Tensor, neighbours: torch.Tensor) -> torch.Tensor:
        """x (T, V, width), neighbours (V, R) → (T, V, width)."""
        ring = ring_maximum(self.neighbour(x), neighbours)
        h = torch.relu(self.centre(x) + ring)
        # The pooled channels are the same at every vertex: one product per shape, then added.
        pooled = self.pooled(h.amax(dim=1, keepdim=True))
        result: torch.Tensor = x + self.last(torch.relu(self.local(h) + pooled))
        return result


class Interpolator(nn.Module):
    """Displacement fields Ω(X, Π_xy Y − X, t): X(t) = X + t Ω."""

    def __init__(self, settings: InterpolationSettings) -> None:
        super().__init__()
        self.first = nn.Linear(7, settings.width)
        self.blocks = nn.ModuleList(EdgeConvBlock(settings.width) for _ in range(settings.blocks))
        self.last = nn.Linear(settings.width, 3)

    def forward(
        self,
        vertices: torch.Tensor,
        target: torch.Tensor,
        times: torch.Tensor,
        neighbours: torch.Tensor,
    ) -> torch.Tensor:
        """X(t) for all times at once.

        vertices (V, 3) X, unit area; target (V, 3) Π_xy Y; times (T,) in [0, 1]; neighbours (V, R).

        Returns:
            (T, V, 3).
        """
        spatial = torch.cat([vertices, target - vertices], dim=1).expand(len(times), -1, -1)
        t = times[:, None, None].expand(-1, len(vertices), 1)
        x = self.first(torch.cat([spatial, t], dim=2))
        for block in self.blocks:
            x = block(x, neighbours)
        result: torch.Tensor = vertices + times[:, None, None] * self.last(x)
        return result


def ring_maximum(values: torch.Tensor, neighbours: torch.Tensor) -> torch.Tensor:
    """Maximum over each vertex's one-ring and itself: (T, V, C), (V, R) → (T, V, C)."""
    result: torch.Tensor = _RingMaximum.apply(values, neighbours)  # type: ignore[no-untyped-call]
    return result


class _RingMaximum(torch.autograd.Function):
    """Ring slot by ring slot and time by time: no (V, R, C) array is made, and a slice stays in
    the cache. The winners are found again in the backward pass, so the forward
    pass computes only maxima.
    """

    @staticmethod
    def forward(ctx: Any, values: torch.Tensor, neighbours: torch.Tensor) -> torch.Tensor:
        best = values.clone()
        for value, maximum in zip(values, best, strict=True):
            for slot in neighbours.T:
                torch.maximum(maximum, value.index_select(0, slot), out=maximum)
        ctx.save_for_backward(values, best, neighbours)
        return best

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None]:
        values, best, neighbours = ctx.saved_tensors
        itself = torch.arange(len(neighbours), device=values.device)[:, None]
        ring = torch.cat([itself, neighbours], dim=1)
        total = torch.zeros_like(values)
        for value, maximum, gradient, sum_ in zip(values, best, gradients[0], total, strict=True):
            # Which slot won, as a float: comparisons to float run at memory speed, masks do not.
            winner = torch.zeros_like(value)
            for position, slot in enumerate(neighbours.T, start=1):
                candidate = value.index_select(0, slot)
                torch.eq(candidate, maximum, out=candidate)
                torch.maximum(winner, candidate.mul_(position), out=winner)
            sum_.scatter_add_(0, torch.gather(ring, 1, winner.long()), gradient)
        return total, None

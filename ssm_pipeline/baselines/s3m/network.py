"""S3M's feature extractor: topology-adaptive graph convolutions on a kNN graph."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import nn


@dataclass(frozen=True, eq=False)
class Graph:
    """A kNN graph as lists of its edges, by receiving and by sending point.

    receivers (n · k,): the points that point 0 sends to, then those of point 1, …, where those of
              point i start at starts[i] (n,).

    Attributes:
        senders: (n · k,): the k points whose values point 0 receives, then those of point 1, ….
    """

    neighbours: int
    senders: torch.Tensor
    receivers: torch.Tensor
    starts: torch.Tensor


def knn_graph(points: np.ndarray, neighbours: int, device: torch.device) -> Graph:
    """Each of the points (n, 3) receives from its nearest other points."""
    _, nearest = cKDTree(points).query(points, neighbours + 1)
    own = nearest == np.arange(len(points))[:, None]
    own[~own.any(axis=1), -1] = True  # points in one place: drop the last instead
    senders = nearest[~own]
    receivers = np.argsort(senders, kind="stable") // neighbours
    counts = np.bincount(senders, minlength=len(points))
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    lists = (torch.as_tensor(part, device=device) for part in (senders, receivers, starts))
    return Graph(neighbours, *lists)


class _Hop(torch.autograd.Function):
    """D^-1/2 A D^-1/2 x. D, the in-degree, is k everywhere, so this is a mean over neighbours.

    By embedding_bag, which sums listed rows without copying them out first; the backward pass
    does the same along the reversed edges.
    """

    @staticmethod
    def forward(ctx: Any, x: torch.Tensor, graph: Graph) -> torch.Tensor:
        ctx.graph = graph
        bags = graph.senders.reshape(-1, graph.neighbours)
        return nn.functional.embedding_bag(bags, x, mode="sum") / graph.neighbours

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None]:
        graph = ctx.graph
        gradient = gradients[0].contiguous()
        back = nn.functional.embedding_bag(graph.receivers, gradient, graph.starts, mode="sum")
        return back / graph.neighbours, None


class TAGConv(nn.Module):
    """Σ_h Â^h x W_h + b for h = 0 … hops. Source: Du et al. 2017 (TAGCN), Eq. 10."""

    def __init__(
        self, inputs: int, outputs: int, hops: int, generator: torch.Generator | None = None
    ) -> None:
        super().__init__()
        self.hops = hops
        bound = inputs**-0.5  # each W_h as a linear layer of its own
        weight = torch.empty((hops + 1) * inputs, outputs)
        self.weight = nn.Parameter(weight.uniform_(-bound, bound, generator=generator))
        self.bias = nn.Parameter(torch.zeros(outputs))

    def forward(self, x: torch.Tensor, graph: Graph) -> torch.Tensor:
        """(n, inputs) → (n, outputs)."""
        hopped = [x]
        for _ in range(self.hops):
            hopped.append(_Hop.apply(hopped[-1], graph))  # type: ignore[no-untyped-call]
        return torch.addmm(self.bias, torch.cat(hopped, dim=1), self.weight)


class FeatureExtractor(nn.Module):
    """Coordinates → descriptors of length 1: TAGConv with 1, 2 and 3 hops, then a linear layer."""

    def __init__(self, size: int, generator: torch.Generator) -> None:
        super().__init__()
        self.first = TAGConv(3, size // 4, 1, generator)
        self.second = TAGConv(size // 4, size // 2, 2, generator)
        self.third = TAGConv(size // 2, size, 3, generator)
        self.last = nn.Linear(size, size)
        with torch.no_grad():  # nn.Linear's own draw would not come from the generator
            for parameter in self.last.parameters():
                parameter.uniform_(-(size**-0.5), size**-0.5, generator=generator)

    def forward(self, points: torch.Tensor, graph: Graph) -> torch.Tensor:
        """points (n, 3) → (n, size)."""
        x = torch.relu(self.first(points, graph))
        x = torch.relu(self.second(x, graph))
        x = torch.relu(self.third(x, graph))
        return nn.functional.normalize(self.last(x), dim=-1)

from typing import Any

import torch
from shapes import basis_of, blob

from ssm_pipeline.interpolation.interpolator import EdgeConvBlock, Interpolator, ring_maximum
from ssm_pipeline.interpolation.settings import InterpolationSettings
from ssm_pipeline.matching.settings import MatchingSettings
from ssm_pipeline.matching.shape import to_shape


def shape_of(seed: int) -> Any:
    return to_shape(
        basis_of(blob(seed, faces=300), 10),
        MatchingSettings(features="wks", descriptors=8),
        dtype=torch.float64,
    )


def test_ring_maximum_and_gradient_equal_the_plain_loop() -> None:
    shape = shape_of(1)
    ring: list[set[int]] = [set() for _ in shape.vertices]
    for start, end in shape.edges.tolist():
        ring[start] |= {start, end}
    generator = torch.Generator().manual_seed(0)
    values = torch.randn(2, len(ring), 5, generator=generator, dtype=torch.float64)
    a, b = values.clone().requires_grad_(), values.clone().requires_grad_()
    fast = ring_maximum(a, shape.neighbours)
    plain = torch.stack([b[:, sorted(members)].amax(dim=1) for members in ring], dim=1)
    torch.testing.assert_close(fast, plain)
    weights = torch.randn(fast.shape, generator=generator, dtype=torch.float64)
    (fast * weights).sum().backward()
    (plain * weights).sum().backward()
    torch.testing.assert_close(a.grad, b.grad)


def test_the_edge_convolution_equals_the_edge_by_edge_one() -> None:
    shape = shape_of(1)
    torch.manual_seed(0)
    block = Interpolator(InterpolationSettings(width=6, blocks=1)).double().blocks[0]
    assert isinstance(block, EdgeConvBlock)
    x = torch.randn(1, len(shape.vertices), 6, dtype=torch.float64)
    W_b = block.neighbour.weight
    W_a = block.centre.weight + W_b
    h = torch.full_like(x[0], -torch.inf)
    self_edges = torch.arange(len(h)).repeat(2, 1).T
    for i, j in torch.cat([shape.edges, self_edges]).tolist():
        edge = torch.relu(W_a @ x[0, i] + W_b @ (x[0, j] - x[0, i]) + block.centre.bias)
        h[i] = torch.maximum(h[i], edge)
    plain = x + block.last(torch.relu(block.local(h) + block.pooled(h.amax(0))))
    torch.testing.assert_close(block(x, shape.neighbours), plain)


def test_starts_at_the_shape_and_times_do_not_mix() -> None:
    shape, goal = shape_of(1), shape_of(1).vertices.flip(1)
    torch.manual_seed(0)
    net = Interpolator(InterpolationSettings(width=6, blocks=2)).double()
    times = torch.tensor([0.0, 0.5, 1.0], dtype=torch.float64)
    together = net(shape.vertices, goal, times, shape.neighbours)
    torch.testing.assert_close(together[0], shape.vertices)
    for k, t in enumerate(times):
        alone = net(shape.vertices, goal, t[None], shape.neighbours)[0]
        torch.testing.assert_close(together[k], alone)

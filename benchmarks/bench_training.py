"""One training step: the project's against a plain reading of the same equations.

    python benchmarks/bench_training.py [--vertices 1000] [--eigenpairs 200] [--plain-times 1 3]
    python benchmarks/bench_training.py --vertices 4000 --plain-times --where

The plain step keeps the dense soft maps for autograd, inverts one system a row of the functional
map, concatenates edge features and takes the SVD of every rotation. Both start from the same
weights; the losses are printed beside each other. Prints seconds, peak memory and the ratio.
`--where`: the floating-point operations of the step's matrix products over this machine's peak, a
plain matrix product measured in the same run, and the operators that take the most time.
"""

from __future__ import annotations

import argparse
import itertools
import resource
import time
from collections.abc import Callable

import fast_simplification
import numpy as np
import torch
import trimesh
from torch.profiler import ProfilerActivity, profile
from torch.utils.flop_counter import FlopCounterMode

from ssm_pipeline.engine.process import keep_large_blocks
from ssm_pipeline.interpolation.interpolator import EdgeConvBlock, Interpolator
from ssm_pipeline.matching.functional_map import resolvent_mask
from ssm_pipeline.matching.settings import MatchingSettings
from ssm_pipeline.matching.shape import Shape, to_shape
from ssm_pipeline.records import Mesh
from ssm_pipeline.spectral.basis import spectral_basis
from ssm_pipeline.spectral.settings import SpectralSettings
from ssm_pipeline.training.loss import pair_loss
from ssm_pipeline.training.networks import Networks
from ssm_pipeline.training.settings import TrainingSettings


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vertices", type=int, default=1000)
    parser.add_argument("--eigenpairs", type=int, default=200)
    parser.add_argument("--time-steps", type=int, nargs="*", default=[1, 3, 7])
    parser.add_argument("--plain-times", type=int, nargs="*", default=[1, 3])
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--where", action="store_true")
    arguments = parser.parse_args()
    keep_large_blocks()
    settings = TrainingSettings(matching=MatchingSettings(features="wks"))
    x, y = (
        to_shape(
            spectral_basis(
                solid(seed, arguments.vertices), SpectralSettings(eigenpairs=arguments.eigenpairs)
            ),
            settings.matching,
            arguments.device,
        )
        for seed in (1, 2)
    )
    networks = Networks.new(settings, 0, arguments.device)
    print(
        f"{len(x.vertices)} and {len(y.vertices)} vertices, k = {arguments.eigenpairs}, "
        f"{arguments.device}, {torch.get_num_threads()} threads"
    )
    for T in arguments.time_steps:

        def step(T: int = T) -> torch.Tensor:
            return pair_loss(x, y, networks, T, settings)[0]

        def plain_step(T: int = T) -> torch.Tensor:
            return plain_loss(x, y, networks, T, settings)

        loss, seconds = timed(step, networks)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        line = f"T = {T}: {seconds:.2f} s, loss {loss:.4f}, process peak {peak:.2f} GB"
        if T in arguments.plain_times:
            plain, plain_seconds = timed(plain_step, networks)
            line += (
                f"; plain {plain_seconds:.2f} s, loss {plain:.4f}; "
                f"ratio {plain_seconds / seconds:.1f}"
            )
        print(line, flush=True)
        if arguments.where:
            say_where(step, seconds)


def say_where(loss_of: Callable[[], torch.Tensor], seconds: float) -> None:
    with FlopCounterMode(display=False) as counter:
        loss_of().backward()
    operations, peak = counter.get_total_flops(), product_rate()
    print(
        f"    {operations / 1e9:.0f} GFLOP in products, {operations / seconds / 1e9:.0f} GFLOP/s, "
        f"{100 * operations / seconds / peak:.0f} % of the {peak / 1e9:.0f} of one plain product"
    )
    with profile(activities=[ProfilerActivity.CPU]) as recorded:
        loss_of().backward()
    events = sorted(recorded.key_averages(), key=lambda event: -event.self_cpu_time_total)
    whole = sum(event.self_cpu_time_total for event in events)
    for event in events[:8]:
        print(f"    {100 * event.self_cpu_time_total / whole:5.1f} %  {event.key}")


def product_rate(size: int = 3000) -> float:
    """Floating-point operations a second of a matrix product, the best of five."""
    A = torch.randn(size, size)
    taken = []
    for _ in range(5):
        start = time.perf_counter()
        A @ A
        taken.append(time.perf_counter() - start)
    return 2 * size**3 / min(taken)


def solid(seed: int, vertices: int) -> Mesh:
    """A lung-sized, uneven closed surface with about so many vertices."""
    generator = np.random.default_rng(seed)
    ball = trimesh.creation.icosphere(5)
    points = ball.vertices * [1.0, 1.3, 2.0]
    points = points * (1 + 0.2 * np.sin(points @ generator.standard_normal((3, 1)) * 2))
    reduced = fast_simplification.simplify(
        np.ascontiguousarray(points, dtype=np.float32),
        ball.faces.astype(np.int32),
        target_count=2 * vertices - 4,
    )
    return Mesh(70.0 * reduced[0], reduced[1], f"solid {seed}")


def timed(loss_of: Callable[[], torch.Tensor], networks: Networks) -> tuple[float, float]:
    """The loss, and the seconds of the second of two forward and backward passes."""
    for _ in range(2):
        for network in networks.both():
            network.zero_grad(set_to_none=True)
        start = time.perf_counter()
        loss = loss_of()
        loss.backward()
        if loss.is_cuda:
            torch.cuda.synchronize()
        seconds = time.perf_counter() - start
    return float(loss.detach()), seconds


def plain_loss(
    x: Shape,
    y: Shape,
    networks: Networks,
    T: int,
    settings: TrainingSettings,
) -> torch.Tensor:
    F_x, F_y = networks.features(x), networks.features(y)
    N_x, N_y = (torch.nn.functional.normalize(F, dim=1) for F in (F_x, F_y))
    Pi_xy = (N_x @ N_y.T / settings.matching.temperature).softmax(dim=1)
    Pi_yx = (N_y @ N_x.T / settings.matching.temperature).softmax(dim=1)
    C_xy, C_yx = plain_map(x, y, F_x, F_y, settings), plain_map(y, x, F_y, F_x, settings)
    one = torch.eye(len(C_xy), device=C_xy.device)
    loss = (C_xy @ C_yx - one).square().sum() + (C_yx @ C_xy - one).square().sum()
    loss = loss + (C_xy.T @ C_xy - one).square().sum() + (C_yx.T @ C_yx - one).square().sum()
    loss = loss + (C_xy - y.projection @ (Pi_yx @ x.eigenvectors)).square().sum()
    loss = loss + (C_yx - x.projection @ (Pi_xy @ y.eigenvectors)).square().sum()
    times = [k / T for k in range(T + 1)]
    X = [plain_pose(x, Pi_xy @ y.vertices, t, networks.interpolator) for t in times]
    Y = [plain_pose(y, Pi_yx @ x.vertices, t, networks.interpolator) for t in times]
    weights = settings.spatial_loss
    for shape, A, B, Pi, other in ((x, X, Y, Pi_xy, y), (y, Y, X, Pi_yx, x)):
        by_area = weights.vertices * shape.mass
        gaps = torch.stack([(A[k] - Pi @ B[T - k]).square().sum(1) for k in range(T + 1)])
        loss = loss + weights.align * (gaps[0] @ by_area)
        for before, after in itertools.pairwise(A):
            loss = loss + weights.arap * 3**0.5 * plain_arap(shape, before, after)
        loss = loss + weights.symmetry * (gaps[1:T] @ by_area).sum()
        if T > 1:
            distances = (gaps[1:] + 1e-12).sqrt()
            loss = loss + weights.variance * (distances.var(dim=0) @ by_area)
        carried = Pi @ other.vertices
        loss = loss + weights.dirichlet * (carried * (shape.laplacian @ carried)).sum()
    return loss


def plain_map(
    x: Shape, y: Shape, F_x: torch.Tensor, F_y: torch.Tensor, settings: TrainingSettings
) -> torch.Tensor:
    A, B = (x.projection @ F_x).double(), (y.projection @ F_y).double()
    matching = settings.matching
    mask = resolvent_mask(x.eigenvalues, y.eigenvalues, matching.resolvent_gamma).double()
    gram, right = A @ A.T, B @ A.T
    rows = [
        torch.linalg.inv(gram + torch.diag(matching.resolvent_weight * mask[i])) @ right[i]
        for i in range(len(B))
    ]
    return torch.stack(rows).to(F_x.dtype)


def plain_pose(
    shape: Shape, target: torch.Tensor, t: float, interpolator: Interpolator
) -> torch.Tensor:
    loops = torch.arange(len(shape.vertices), device=target.device).repeat(2, 1).T
    start, end = torch.cat([shape.edges, loops]).T
    time_column = torch.full((len(shape.vertices), 1), t, device=target.device)
    x = interpolator.first(torch.cat([shape.vertices, target - shape.vertices, time_column], dim=1))
    for block in interpolator.blocks:
        assert isinstance(block, EdgeConvBlock)
        W_b = block.neighbour.weight
        W_a = block.centre.weight + W_b
        features = torch.cat([x[start], x[end] - x[start]], dim=1)
        edge = torch.relu(features @ torch.cat([W_a, W_b], dim=1).T + block.centre.bias)
        index = start[:, None].expand_as(edge)
        h = torch.zeros_like(x).scatter_reduce(0, index, edge, "amax", include_self=False)
        pooled = block.pooled(h.amax(dim=0).expand_as(h))
        x = x + block.last(torch.relu(block.local(h) + pooled))
    pose: torch.Tensor = shape.vertices + t * interpolator.last(x)
    return pose


def plain_arap(shape: Shape, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
    start, end = shape.edges.T
    e, moved = before[start] - before[end], after[start] - after[end]
    outer = shape.edge_weights[:, None, None] * moved[:, :, None] * e[:, None, :]
    covariance = torch.zeros(len(before), 3, 3, device=e.device).index_add(0, start, outer)
    with torch.no_grad():
        U, _, Vh = torch.linalg.svd(covariance)
        signs = torch.ones_like(U[:, 0])
        signs[:, 2] = torch.sign(torch.linalg.det(U @ Vh))
        R = (U * signs[:, None]) @ Vh
    turned = torch.einsum("eij,ej->ei", R[start], e)
    return (shape.edge_weights * (turned - moved).square().sum(1)).sum()


if __name__ == "__main__":
    main()

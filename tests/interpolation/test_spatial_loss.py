"""Every form of the spatial loss equals its formula, written plainly with whole maps."""

from typing import Any, cast

import pytest
import torch
from shapes import basis_of, blob
from torch.nn.functional import normalize

from ssm_pipeline.interpolation.interpolator import Interpolator
from ssm_pipeline.interpolation.settings import InterpolationSettings, SpatialLossSettings
from ssm_pipeline.interpolation.spatial_loss import spatial_loss
from ssm_pipeline.matching.pair import match_pair
from ssm_pipeline.matching.settings import MatchingSettings
from ssm_pipeline.matching.shape import to_shape

SETTINGS = MatchingSettings(features="wks", descriptors=8)
OURS = SpatialLossSettings(align=2, arap=11, symmetry=3, variance=5, dirichlet=7)
AUTHORS = OURS.model_copy(
    update={"arap_both_ways": True, "symmetry_mean": True, "arap_edges": "uniform"}
)
PRINTED = OURS.model_copy(update={"align_form": "printed", "arap_edges": "uniform"})


@pytest.fixture(scope="module")
def pair() -> Any:
    x, y = (
        to_shape(basis_of(blob(i, faces=200), 10), SETTINGS, dtype=torch.float64) for i in (1, 2)
    )
    generator = torch.Generator().manual_seed(0)
    F_x, F_y = (
        torch.randn(len(s.vertices), 12, dtype=torch.float64, generator=generator) for s in (x, y)
    )
    return match_pair(x, y, F_x, F_y, SETTINGS)


@pytest.fixture(scope="module")
def net() -> Any:
    torch.manual_seed(0)
    return Interpolator(InterpolationSettings(width=8, blocks=2)).double()


def whole_map(F_x: Any, F_y: Any) -> Any:
    return (normalize(F_x, dim=1) @ normalize(F_y, dim=1).T / SETTINGS.temperature).softmax(1)


@torch.no_grad()
def plain_arap(before: Any, after: Any, edges: Any, weights: Any) -> Any:
    """By the singular value decomposition, vertex by vertex."""
    total = 0.0
    for vertex in range(len(before)):
        own = edges[:, 0] == vertex
        e = before[vertex] - before[edges[own, 1]]
        f = after[vertex] - after[edges[own, 1]]
        U, _, Vh = torch.linalg.svd((weights[own, None] * e).T @ f)
        signs = torch.diag(torch.tensor([1.0, 1, torch.det(Vh.T @ U.T)], dtype=e.dtype))
        R = Vh.T @ signs @ U.T
        total += (weights[own] * (e @ R.T - f).square().sum(1)).sum()
    return total


@pytest.mark.parametrize("settings", [OURS, AUTHORS, PRINTED], ids=["ours", "authors", "printed"])
@pytest.mark.parametrize("T", [1, 3])
def test_terms_equal_the_plain_formulas(pair: Any, net: Any, settings: Any, T: int) -> None:
    with torch.no_grad():
        terms = spatial_loss(pair, net, T, settings)
    x, y = pair.shape_x, pair.shape_y
    Pi_xy, Pi_yx = (
        whole_map(pair.features_x, pair.features_y),
        whole_map(pair.features_y, pair.features_x),
    )
    times = torch.arange(T + 1, dtype=torch.float64) / T
    X = net(x.vertices, Pi_xy @ y.vertices, times, x.neighbours)
    Y = net(y.vertices, Pi_yx @ x.vertices, times, y.neighbours)
    expected: dict[str, Any] = dict.fromkeys(
        ("align", "arap", "symmetry", "variance", "dirichlet"), 0.0
    )
    for A, B, Pi, target, shape in ((X, Y, Pi_xy, y, x), (Y, X, Pi_yx, x, y)):
        area = 5000 * shape.mass
        carried = Pi @ target.vertices
        printed = settings.align_form == "printed"
        gap = A[T] - carried if printed else shape.vertices - Pi @ B[T]
        expected["align"] += 2 * (area * gap.square().sum(1)).sum()
        cotangent = settings.arap_edges == "cotangent"
        weights = 3**0.5 * shape.edge_weights if cotangent else torch.ones_like(shape.edge_weights)
        for k in range(T):
            expected["arap"] += 11 * plain_arap(A[k], A[k + 1], shape.edges, weights)
            if settings.arap_both_ways:
                expected["arap"] += 11 * plain_arap(A[k + 1], A[k], shape.edges, weights)
        gaps = torch.stack([(A[k] - Pi @ B[T - k]).norm(dim=1) for k in range(T + 1)])
        if T > 1:
            share = T - 1 if settings.symmetry_mean else 1
            expected["symmetry"] += 3 * (area * gaps[1:T].square()).sum() / share
            spread = ((gaps[1:] - gaps[1:].mean(0)) ** 2).sum(0) / (T - 1)
            expected["variance"] += 5 * (area * spread).sum()
        expected["dirichlet"] += 7 * torch.trace(carried.T @ (shape.laplacian @ carried))
    for name, value in expected.items():
        value = torch.as_tensor(value, dtype=torch.float64)
        torch.testing.assert_close(terms[name].detach(), value.detach(), rtol=1e-6, atol=1e-8)


def test_no_weights_no_terms(pair: Any, net: Any) -> None:
    assert spatial_loss(pair, net, 1, SpatialLossSettings.none()) == {}


class TowardsTheMap(torch.nn.Module):
    """The degenerate interpolator that the paper warns of: Ω = Π Y − X."""

    def forward(self, vertices: Any, target: Any, times: Any, neighbours: Any) -> Any:
        return vertices + times[:, None, None] * (target - vertices)


def test_the_degenerate_interpolation_costs(pair: Any) -> None:
    """Printed alignment calls it perfect, however blurred the map; the cycle does not."""
    by_form = {
        form: spatial_loss(
            pair,
            cast(Interpolator, TowardsTheMap()),
            1,
            OURS.model_copy(update={"align_form": form, "arap": 11}),
        )
        for form in ("printed", "cycle")
    }
    assert by_form["printed"]["align"] < 1e-20
    assert by_form["cycle"]["align"] > 1.0
    assert all(terms["arap"] > 1.0 for terms in by_form.values())

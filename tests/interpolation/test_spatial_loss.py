import torch
from shapes import basis_of, blob

from ssm_pipeline.interpolation.interpolator import Interpolator
from ssm_pipeline.interpolation.settings import InterpolationSettings, SpatialLossWeights
from ssm_pipeline.interpolation.spatial_loss import spatial_loss
from ssm_pipeline.matching.settings import MatchingSettings
from ssm_pipeline.matching.shape import to_shape
from ssm_pipeline.matching.spectral_loss import pair_maps

SETTINGS = MatchingSettings(descriptors=8)


def setting():
    x, y = (
        to_shape(basis_of(blob(i, faces=200), 10), SETTINGS, dtype=torch.float64) for i in (1, 2)
    )
    torch.manual_seed(0)
    net = Interpolator(InterpolationSettings(width=8, blocks=2)).double()
    F_x, F_y = (torch.randn(len(s.vertices), 12, dtype=torch.float64) for s in (x, y))
    return x, y, F_x, F_y, pair_maps(x, y, F_x, F_y, SETTINGS), net


def dense_map(F_x, F_y):
    F_x, F_y = (torch.nn.functional.normalize(F, dim=1) for F in (F_x, F_y))
    return (F_x @ F_y.T / SETTINGS.temperature).softmax(1)


def test_terms_equal_the_plain_formulas():
    x, y, F_x, F_y, maps, net = setting()
    T, weights = 3, SpatialLossWeights(align=2, arap=0, symmetry=3, variance=5, dirichlet=7)
    terms = spatial_loss(x, y, F_x, F_y, maps, net, T, weights, SETTINGS)
    Pi_xy, Pi_yx = dense_map(F_x, F_y), dense_map(F_y, F_x)
    times = torch.arange(T + 1, dtype=torch.float64) / T
    X = net(x.vertices, Pi_xy @ y.vertices, times, x.neighbours)
    Y = net(y.vertices, Pi_yx @ x.vertices, times, y.neighbours)
    expected = {"align": 0.0, "symmetry": 0.0, "variance": 0.0, "dirichlet": 0.0}
    for A, B, Pi, target, shape in ((X, Y, Pi_xy, y, x), (Y, X, Pi_yx, x, y)):
        carried = Pi @ target.vertices
        expected["align"] += 2 * (A[T] - carried).square().sum()
        gaps = torch.stack([(A[k] - Pi @ B[T - k]).norm(dim=1) for k in range(T + 1)])
        expected["symmetry"] += 3 * gaps[1:T].square().sum()
        expected["variance"] += 5 * ((gaps - gaps.mean(0)) ** 2).mean(0).sum()
        expected["dirichlet"] += 7 * torch.trace(carried.T @ (shape.stiffness @ carried))
    for name, value in expected.items():
        torch.testing.assert_close(terms[name], value, rtol=1e-6, atol=1e-8)


def test_no_time_steps_align_only():
    terms = spatial_loss(*setting()[:5], setting()[5], 0, SpatialLossWeights(), SETTINGS)
    assert list(terms) == ["align"]

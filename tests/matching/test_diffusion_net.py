import dataclasses
from typing import Any

import numpy as np
import torch
from shapes import basis_of, blob

from ssm_pipeline.matching.diffusion_net import FeatureNetwork, standardised
from ssm_pipeline.matching.pair import match_pair
from ssm_pipeline.matching.settings import MatchingSettings, SpectralLossWeights
from ssm_pipeline.matching.shape import to_shape
from ssm_pipeline.matching.spectral_loss import spectral_loss
from ssm_pipeline.records import Mesh

SETTINGS = MatchingSettings(features="wks", descriptors=16, channels=24, width=12, blocks=2)


def network(settings: Any = SETTINGS) -> Any:
    torch.manual_seed(0)
    return FeatureNetwork(settings).double()


def test_features_follow_renumbering_rotation_and_size() -> None:
    mesh = blob(1)
    generator = np.random.default_rng(0)
    order = generator.permutation(len(mesh.vertices))
    turn = np.linalg.qr(generator.standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    moved = Mesh(3 * mesh.vertices[order] @ turn.T, np.argsort(order)[mesh.faces], "moved")
    a, b = (to_shape(basis_of(m), SETTINGS, dtype=torch.float64) for m in (mesh, moved))
    net = network()
    # The tangent frames and eigenvector signs differ between the two: neither may matter.
    torch.testing.assert_close(net(a)[order], net(b), rtol=1e-4, atol=1e-4)


def test_sparse_gradients_pass_the_gradient_back() -> None:
    shape = to_shape(basis_of(blob(1, faces=300), 10), SETTINGS, dtype=torch.float64)
    x = torch.randn(len(shape.vertices), 3, dtype=torch.float64, requires_grad=True)
    dense = shape.gradients.forward_csr.to_dense()
    torch.testing.assert_close(shape.gradients @ x, dense @ x)
    (shape.gradients @ x).sin().sum().backward()
    torch.testing.assert_close(x.grad, dense.T @ (dense @ x.detach()).cos())


def test_every_weight_gets_a_gradient_from_the_spectral_loss() -> None:
    x, y = (to_shape(basis_of(blob(i)), SETTINGS, dtype=torch.float64) for i in (1, 2))
    net = network()
    terms = spectral_loss(match_pair(x, y, net(x), net(y), SETTINGS), SpectralLossWeights())
    torch.stack(list(terms.values())).sum().backward()
    for name, parameter in net.named_parameters():
        assert parameter.grad is not None, name
        if name != "last.bias":  # a shift of all features is taken out again
            assert parameter.grad.abs().max() > 0, name


def test_an_identical_pair_with_sharp_features_has_no_loss() -> None:
    shape = to_shape(basis_of(blob(1)), SETTINGS, dtype=torch.float64)
    features = torch.eye(len(shape.vertices), dtype=torch.float64)
    sharp = SETTINGS.model_copy(update={"temperature": 0.01})
    maps = match_pair(shape, shape, features, features, sharp)
    for name, term in spectral_loss(maps, SpectralLossWeights()).items():
        assert term < 1e-6, name


def test_each_spectral_term_is_its_formula() -> None:
    generator = torch.Generator().manual_seed(2)
    shape = to_shape(basis_of(blob(1, faces=300), 10), SETTINGS, dtype=torch.float64)
    features = torch.randn(len(shape.vertices), 12, dtype=torch.float64, generator=generator)
    pair = match_pair(shape, shape, features, features, SETTINGS)
    C_xy, C_yx, P_xy, P_yx = torch.randn(4, 10, 10, dtype=torch.float64, generator=generator)
    pair = dataclasses.replace(pair, C_xy=C_xy, C_yx=C_yx, P_xy=P_xy, P_yx=P_yx)
    found = spectral_loss(pair, SpectralLossWeights(bijectivity=2, orthogonality=3, coupling=5))
    a, b, p, q = (m.numpy() for m in (C_xy, C_yx, P_xy, P_yx))
    one = np.eye(10)
    expected = {
        "bijectivity": 2 * (((a @ b - one) ** 2).sum() + ((b @ a - one) ** 2).sum()),
        "orthogonality": 3 * (((a.T @ a - one) ** 2).sum() + ((b.T @ b - one) ** 2).sum()),
        "coupling": 5 * (((a - p) ** 2).sum() + ((b - q) ** 2).sum()),
    }
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_allclose(float(found[name]), value, rtol=1e-12)


def test_each_map_leads_in_the_direction_of_its_name() -> None:
    """X and Y have different bases, so that a transposed or exchanged map shows."""
    x = to_shape(basis_of(blob(1), 10), SETTINGS, dtype=torch.float64)
    y = to_shape(basis_of(blob(2), 12), SETTINGS, dtype=torch.float64)
    generator = torch.Generator().manual_seed(1)
    F_x, F_y = (
        torch.randn(len(s.vertices), 14, dtype=torch.float64, generator=generator) for s in (x, y)
    )
    pair = match_pair(x, y, F_x, F_y, SETTINGS)
    assert pair.C_xy.shape == pair.P_xy.shape == (12, 10)
    unit_x, unit_y = (F / F.norm(dim=1, keepdim=True) for F in (F_x, F_y))
    Pi_yx = (unit_y @ unit_x.T / SETTINGS.temperature).softmax(dim=1)
    torch.testing.assert_close(pair.P_xy, y.projection @ Pi_yx @ x.eigenvectors)
    A, B = x.projection @ F_x, y.projection @ F_y
    # With A A^T well conditioned and the penalty small, C_xy takes X's coefficients to Y's.
    free = SETTINGS.model_copy(update={"resolvent_weight": 0.0})
    found = match_pair(x, y, F_x, F_y, free)
    torch.testing.assert_close(found.C_xy, B @ torch.linalg.pinv(A), rtol=1e-6, atol=1e-6)
    torch.testing.assert_close(found.C_yx, A @ torch.linalg.pinv(B), rtol=1e-6, atol=1e-6)
    Pi_xy = (unit_x @ unit_y.T / SETTINGS.temperature).softmax(dim=1)
    torch.testing.assert_close(pair.P_yx, x.projection @ Pi_xy @ y.eigenvectors)


def test_features_are_standardised_by_area() -> None:
    generator = torch.Generator().manual_seed(0)
    mass = torch.rand(50, dtype=torch.float64, generator=generator)
    raw = 7 + 3 * torch.randn(50, 4, dtype=torch.float64, generator=generator)
    F, weight = standardised(raw, mass), mass / mass.sum()
    torch.testing.assert_close(weight @ F, torch.zeros(4, dtype=torch.float64))
    torch.testing.assert_close(weight @ F.square(), torch.ones(4, dtype=torch.float64))
    # What one channel's unit and offset are tells nothing.
    torch.testing.assert_close(standardised(20 * raw - 3, mass), F, rtol=1e-6, atol=1e-6)


def test_coordinates_can_be_read_too() -> None:
    settings = SETTINGS.model_copy(update={"features": "xyz+wks"})
    shape = to_shape(basis_of(blob(1)), settings)
    assert shape.inputs.shape[1] == 19
    assert torch.isfinite(FeatureNetwork(settings)(shape)).all()
    assert dataclasses.is_dataclass(shape)

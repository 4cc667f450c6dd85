from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from shapes import basis_of, blob

from ssm_pipeline.interpolation.arap import arap_energy, best_rotations
from ssm_pipeline.matching.settings import MatchingSettings
from ssm_pipeline.matching.shape import to_shape


def shape_of(seed: int = 1) -> Any:
    return to_shape(
        basis_of(blob(seed, faces=200), 10),
        MatchingSettings(features="wks", descriptors=8),
        dtype=torch.float64,
    )


def test_a_rigid_motion_costs_nothing() -> None:
    shape = shape_of()
    turn = torch.tensor(Rotation.random(random_state=0).as_matrix())
    moved = shape.vertices @ turn.T + 5.0
    energy = arap_energy(shape.vertices[None], moved[None], shape.edges, shape.edge_weights)
    assert energy.item() < 1e-18


def test_a_stretch_costs_what_it_must() -> None:
    shape = shape_of()
    # Under x → 2x the best rotation is the identity: E = Σ w |e|² over directed edges, which is
    # twice trace(XᵀLX).
    energy = arap_energy(
        shape.vertices[None], 2 * shape.vertices[None], shape.edges, shape.edge_weights
    )
    expected = 2 * (shape.vertices * (shape.laplacian @ shape.vertices)).sum()
    torch.testing.assert_close(energy[0], expected, rtol=1e-6, atol=0)


def test_gradient_against_finite_differences_through_the_rotations() -> None:
    shape = shape_of()
    noise = torch.randn(
        2, *shape.vertices.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0)
    )
    a = (shape.vertices + 0.02 * noise[0])[None].requires_grad_()
    b = (1.1 * shape.vertices + 0.02 * noise[1])[None].requires_grad_()
    arap_energy(a, b, shape.edges, shape.edge_weights).sum().backward()
    for moved, which in ((a, 0), (b, 1)):
        direction = torch.randn_like(moved)
        step, values = 1e-5, []
        for sign in (1, -1):
            pair = [a.detach(), b.detach()]
            pair[which] = pair[which] + sign * step * direction
            energy = arap_energy(pair[0], pair[1], shape.edges, shape.edge_weights)
            values.append(energy.item())
        numeric = (values[0] - values[1]) / (2 * step)
        # Central differences: error of order step² of an energy of order one.
        np.testing.assert_allclose((moved.grad * direction).sum().item(), numeric, rtol=1e-5)


def test_rotations_equal_the_svd_even_for_reflections() -> None:
    generator = torch.Generator().manual_seed(0)
    matrices = torch.randn(500, 3, 3, generator=generator, dtype=torch.float64)
    assert (torch.linalg.det(matrices) < 0).any()
    fast = best_rotations(matrices)
    U, _, Vh = torch.linalg.svd(matrices)
    U[..., 2] *= torch.sign(torch.linalg.det(U @ Vh))[:, None]
    torch.testing.assert_close(torch.linalg.det(fast), torch.ones(500, dtype=torch.float64))
    # Close to a vanishing determinant Newton's last digits go; 1e-6 is far below float32's.
    torch.testing.assert_close(fast, U @ Vh, rtol=0, atol=1e-6)

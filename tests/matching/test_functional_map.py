from typing import Any

import numpy as np
import torch

from ssm_pipeline.matching.functional_map import functional_map, resolvent_mask


def problem(k: Any = 9, channels: Any = 14) -> Any:
    generator = torch.Generator().manual_seed(3)
    A = torch.randn(k, channels, generator=generator, dtype=torch.float64)
    B = torch.randn(k, channels, generator=generator, dtype=torch.float64)
    ev_x = torch.linspace(0, 50, k, dtype=torch.float64)
    ev_y = torch.linspace(0, 60, k, dtype=torch.float64)
    return A, B, 3.0 * resolvent_mask(ev_x, ev_y, 0.5)


def test_rows_equal_a_loop_of_solves() -> None:
    A, B, penalty = problem()
    C = functional_map(A, B, penalty)
    for i in range(len(B)):
        row = np.linalg.solve((A @ A.T + torch.diag(penalty[i])).numpy(), (A @ B[i]).numpy())
        # The regularisation of 1e-10 of the mean diagonal is all that differs.
        np.testing.assert_allclose(C[i], row, rtol=1e-7, atol=1e-8)


def test_it_is_the_minimum() -> None:
    A, B, penalty = problem()
    C = functional_map(A, B, penalty).requires_grad_()
    ((C @ A - B).square().sum() + (penalty * C.square()).sum()).backward()
    assert C.grad is not None
    assert C.grad.abs().max() < 1e-6


def test_identical_pair_gives_the_identity() -> None:
    A, _, _ = problem()
    values = torch.linspace(0, 50, len(A), dtype=torch.float64)
    # Off the diagonal the penalty pushes to zero, where the identity has zero: nothing to trade.
    C = functional_map(A, A, 100 * resolvent_mask(values, values, 0.5))
    torch.testing.assert_close(C, torch.eye(len(A), dtype=torch.float64), rtol=0, atol=1e-7)


def test_a_known_map_is_recovered() -> None:
    A, _, penalty = problem()
    known = torch.linalg.qr(torch.randn(9, 9, dtype=torch.float64))[0]
    torch.testing.assert_close(functional_map(A, known @ A, 0 * penalty), known, rtol=0, atol=1e-7)


def test_gradient_against_finite_differences() -> None:
    A, B, penalty = problem(4, 6)
    assert torch.autograd.gradcheck(
        lambda a, b: functional_map(a, b, penalty), (A.requires_grad_(), B.requires_grad_())
    )


def test_resolvent_mask_is_zero_where_frequencies_agree() -> None:
    values = torch.tensor([0.0, 2.0, 5.0])
    mask = resolvent_mask(values, values, 0.5)
    torch.testing.assert_close(mask.diagonal(), torch.zeros(3))
    assert mask[0, 2] > mask[1, 2] > 0
    # By hand: g = 0 and g = 1 give (1/2 − 0)² + (1/2 − 1)² = 1/2.
    torch.testing.assert_close(mask[0, 2], torch.tensor(0.5))

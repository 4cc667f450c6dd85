"""The regularised functional map, all its rows solved as one batch."""

from __future__ import annotations

from typing import Any

import torch


def resolvent_mask(
    eigenvalues_x: torch.Tensor, eigenvalues_y: torch.Tensor, gamma: float
) -> torch.Tensor:
    """(K_y, K_x) penalty of C_xy's entries: small where the frequencies agree.

    Source: Ren et al. 2019, "Structured regularization of functional map computations", Eq. 8;
    eigenvalues divided by the larger of the two maxima.
    """
    largest = torch.maximum(eigenvalues_x.max(), eigenvalues_y.max())
    g_x = (eigenvalues_x / largest)[None, :] ** gamma
    g_y = (eigenvalues_y / largest)[:, None] ** gamma
    real = g_y / (g_y**2 + 1) - g_x / (g_x**2 + 1)
    imaginary = 1 / (g_y**2 + 1) - 1 / (g_x**2 + 1)
    return real**2 + imaginary**2


def functional_map(
    spectral_x: torch.Tensor, spectral_y: torch.Tensor, penalty: torch.Tensor
) -> torch.Tensor:
    """C_xy (K_y, K_x) = argmin ‖C A − B‖² + Σ_ij penalty_ij C_ij².

    Row i solves (A Aᵀ + diag(penalty_i)) c_i = A b_i. Solved in double precision, because the Gram
    matrix of untrained features is close to singular.

    Args:
        spectral_x: A = Φ_X†F_X (K_x, channels); spectral_y B = Φ_Y†F_Y (K_y, channels)
        penalty: (K_y, K_x), λ times the mask.
    """
    A, B = spectral_x.double(), spectral_y.double()
    gram, right = A @ A.T, B @ A.T
    rows: torch.Tensor = _RidgeRows.apply(gram, right, penalty.double())  # type: ignore[no-untyped-call]
    return rows.to(spectral_x.dtype)


class _RidgeRows(torch.autograd.Function):
    """Rows c_i of (G + diag(p_i)) c_i = r_i: batched Cholesky, its factor used again backward."""

    @staticmethod
    def forward(
        ctx: Any, gram: torch.Tensor, right: torch.Tensor, penalty: torch.Tensor
    ) -> torch.Tensor:
        tiny = 1e-10 * gram.diagonal().mean()
        systems = gram + torch.diag_embed(penalty + tiny)
        factor = torch.linalg.cholesky(systems)
        rows = torch.cholesky_solve(right.unsqueeze(-1), factor).squeeze(-1)
        ctx.save_for_backward(factor, rows)
        return rows

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, None]:
        factor, rows = ctx.saved_tensors
        adjoint = torch.cholesky_solve(gradients[0].unsqueeze(-1), factor).squeeze(-1)
        return -adjoint.T @ rows, adjoint, None

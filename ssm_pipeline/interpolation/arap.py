"""As-rigid-as-possible energy between poses of one mesh."""

from __future__ import annotations

import torch


def arap_energy(
    poses: torch.Tensor,
    next_poses: torch.Tensor,
    edges: torch.Tensor,
    edge_weights: torch.Tensor,
) -> torch.Tensor:
    """E_arap for each pair of poses: Σ_i Σ_j∈N(i) w_ij ‖R_i (x_i − x_j) − (x'_i − x'_j)‖².

    poses, next_poses (T, V, 3); edges (E, 2) directed; edge_weights (E,) cotangent, ≥ 0.

    Returns:
        (T,). R_i minimises its term in closed form, so by the envelope theorem the gradient may
        treat it as constant, and does.

    Source: Sorkine and Alexa 2007.
    """
    start, end = edges.T
    before = poses[:, start] - poses[:, end]
    after = next_poses[:, start] - next_poses[:, end]
    with torch.no_grad():
        products = (edge_weights[:, None] * before).unsqueeze(-1) * after.unsqueeze(-2)
        covariance = torch.zeros(
            *poses.shape[:2], 3, 3, dtype=poses.dtype, device=poses.device
        ).index_add_(1, start, products)
        rotations = best_rotations(covariance.transpose(-1, -2))[:, start]
    turned = (rotations * before.unsqueeze(-2)).sum(-1)
    return (edge_weights * (turned - after).square().sum(-1)).sum(-1)


def best_rotations(matrices: torch.Tensor, steps: int = 12) -> torch.Tensor:
    """The rotations nearest to (…, 3, 3) matrices, determinant +1.

    Newton's iteration for the polar factor where the determinant is safely positive; it would
    find a reflection elsewhere, so those few go through the SVD. Source: Higham 1986.
    """
    scale = matrices.square().sum((-1, -2), keepdim=True).sqrt()
    X = matrices / scale.clamp_min(torch.finfo(matrices.dtype).tiny)
    unsafe = _cofactors_and_determinant(X)[1] < 1e-4  # of a matrix of Frobenius norm 1
    for _ in range(steps):
        cofactors, determinant = _cofactors_and_determinant(X)
        inverse_transpose = cofactors / determinant[..., None, None]
        # Scaling by the norms makes the iteration converge in few steps from any start.
        gamma = (
            inverse_transpose.square().sum((-1, -2), keepdim=True)
            / X.square().sum((-1, -2), keepdim=True)
        ) ** 0.25
        X = 0.5 * (gamma * X + inverse_transpose / gamma)
    if unsafe.any():
        U, _, Vh = torch.linalg.svd(matrices[unsafe])
        signs = torch.ones_like(U[..., 0])
        signs[..., 2] = torch.sign(torch.linalg.det(U @ Vh))
        X[unsafe] = (U * signs[..., None, :]) @ Vh
    return X


def _cofactors_and_determinant(X: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    a, b, c = X.unbind(-2)
    cofactors = torch.stack(
        [torch.linalg.cross(b, c), torch.linalg.cross(c, a), torch.linalg.cross(a, b)], dim=-2
    )
    return cofactors, (a * cofactors[..., 0, :]).sum(-1)

"""S3M's unsupervised loss on functional maps, for all ordered pairs of a set of shapes at once."""

from __future__ import annotations

import torch

from ssm_pipeline.baselines.s3m.settings import S3MSettings


def multiplication_operators(
    descriptors: torch.Tensor, projections: torch.Tensor, eigenvectors: torch.Tensor
) -> torch.Tensor:
    """Φ† diag(f) Φ for each descriptor f: multiplying by f, as seen in the eigenfunctions.

    descriptors (B, n, p), projections Φ† (B, k, n), eigenvectors Φ (B, n, k) → (B, p, k, k).
    Source: Nogneng and Ovsjanikov 2017.
    """
    B, n, k = eigenvectors.shape
    products = projections.mT[:, :, :, None] * eigenvectors[:, :, None, :]
    return (descriptors.mT @ products.reshape(B, n, k * k)).reshape(B, -1, k, k)


def pair_losses(
    C: torch.Tensor,
    C_back: torch.Tensor,
    eigenvalues_x: torch.Tensor,
    eigenvalues_y: torch.Tensor,
    operators_x: torch.Tensor,
    operators_y: torch.Tensor,
    settings: S3MSettings,
) -> torch.Tensor:
    """The loss of each ordered pair (x, y) in one direction.

    C           (X, Y, k, k) maps from shape x to shape y; C_back (X, Y, k, k) from y to x.
    eigenvalues (X, k) and (Y, k); operators (X, p, k, k) and (Y, p, k, k).
    Returns     (X, Y). A pair's loss in the paper is this plus the same with x and y exchanged.
    Each term is a mean over a matrix's entries. Source: Bastian et al. 2023, Eq. 2 to 5; Roufosse
    et al. 2019.
    """
    one = torch.eye(C.shape[-1], dtype=C.dtype, device=C.device)
    bijectivity = _mean_square(C_back @ C - one)
    orthogonality = _mean_square(C.mT @ C - one)
    laplacian = _mean_square(
        C * eigenvalues_x[:, None, None, :] - eigenvalues_y[None, :, :, None] * C
    )
    per_descriptor = C[:, :, None]
    preservation = _mean_square(
        per_descriptor @ operators_x[:, None] - operators_y[None, :] @ per_descriptor
    ).mean(dim=-1)
    return (
        settings.bijectivity * bijectivity
        + settings.orthogonality * orthogonality
        + settings.laplacian * laplacian
        + settings.preservation * preservation
    )


def _mean_square(matrices: torch.Tensor) -> torch.Tensor:
    return matrices.square().mean(dim=(-2, -1))

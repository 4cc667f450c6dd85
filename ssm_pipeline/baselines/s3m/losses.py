"""S3M's unsupervised loss on functional maps, for many pairs of shapes at once."""

from __future__ import annotations

import torch

from ssm_pipeline.baselines.s3m.settings import S3MSettings


def eigenvector_products(eigenvectors: torch.Tensor, mass: torch.Tensor) -> torch.Tensor:
    """(n, k (k + 1) / 2): mass φ_i φ_j for i ≤ j, of eigenvectors (n, k) and lumped mass (n,)."""
    k = eigenvectors.shape[1]
    row, column = torch.triu_indices(k, k, device=eigenvectors.device)
    columns = eigenvectors.T.contiguous()  # rows are what is gathered
    return (mass * columns[row] * columns[column]).T.contiguous()


def multiplication_operators(
    descriptors: torch.Tensor, products: torch.Tensor, k: int
) -> torch.Tensor:
    """Φ† diag(f) Φ for each descriptor f: multiplying by f, as seen in the k eigenfunctions.

    descriptors (n, p); products as `eigenvector_products`, which no training step changes
    → (p, k, k), symmetric, so that half of each is computed.
    Source: Nogneng and Ovsjanikov 2017.
    """
    row, column = torch.triu_indices(k, k, device=descriptors.device)
    place = torch.empty(k, k, dtype=torch.long, device=descriptors.device)
    place[row, column] = place[column, row] = torch.arange(len(row), device=descriptors.device)
    return (descriptors.T @ products)[:, place]


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

    eigenvalues (…, k) of x and of y; operators (…, p, k, k); all broadcast against each other. Each
    term is a mean over a matrix's entries.

    Args:
        C: (…, k, k) maps from shape x to shape y; C_back (…, k, k) from y to x.

    Returns:
        (…). A pair's loss in the paper is this plus the same with x and y exchanged.

    Source: Bastian et al. 2023, Eq. 2 to 5; Roufosse et al. 2019.
    """
    one = torch.eye(C.shape[-1], dtype=C.dtype, device=C.device)
    bijectivity = _mean_square(C_back @ C - one)
    orthogonality = _mean_square(C.mT @ C - one)
    laplacian = _mean_square(C * eigenvalues_x[..., None, :] - eigenvalues_y[..., :, None] * C)
    # All descriptors of a pair in one product each: thousands of 20 × 20 ones are slow.
    x_side = C @ operators_x.movedim(-3, -2).flatten(-2)  # (…, k, p · k)
    y_side = operators_y.flatten(-3, -2) @ C  # (…, p · k, k)
    count, k = operators_x.shape[-3], C.shape[-1]
    difference = x_side.unflatten(-1, (count, k)).movedim(-2, -3) - y_side.unflatten(-2, (count, k))
    preservation = _mean_square(difference).mean(dim=-1)
    return (
        settings.bijectivity * bijectivity
        + settings.orthogonality * orthogonality
        + settings.laplacian * laplacian
        + settings.preservation * preservation
    )


def _mean_square(matrices: torch.Tensor) -> torch.Tensor:
    return matrices.square().mean(dim=(-2, -1))

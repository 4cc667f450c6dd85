"""How much a surface is distorted, whatever its position: what tells a good match from a bad one
where both reach the target."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp


def distortion(rest: np.ndarray, moved: np.ndarray, laplacian: sp.csr_matrix) -> float:
    """½ Σ_ij w_ij ‖(m_i − m_j) − R_i (r_i − r_j)‖², R_i the best rotation of each one-ring.

    rest, moved (V, 3): the same mesh before and after; laplacian (V, V): of `rest`, whose
    off-diagonal entries are −w_ij. Zero for a rigid motion, and near trace(ΔᵀLΔ) for a small
    offset Δ without rotation. Source: Sorkine and Alexa 2007, Eq. 3.

    >>> import trimesh
    >>> from ssm_pipeline.records import Mesh
    >>> from ssm_pipeline.spectral.basis import spectral_basis
    >>> ball = trimesh.creation.icosphere(3)
    >>> basis = spectral_basis(Mesh(ball.vertices, ball.faces, "ball"))
    >>> turned = basis.vertices[:, [1, 2, 0]] + 5.0
    >>> bool(distortion(basis.vertices, turned, basis.laplacian) < 1e-12)
    True
    """
    entries = laplacian.tocoo()
    off_diagonal = entries.row != entries.col
    i, j = entries.row[off_diagonal], entries.col[off_diagonal]
    w = np.maximum(-entries.data[off_diagonal], 0.0)
    edge, after = rest[i] - rest[j], moved[i] - moved[j]
    covariance = np.stack(
        [
            np.bincount(i, w * after[:, a] * edge[:, b], len(rest))
            for a in range(3)
            for b in range(3)
        ],
        axis=1,
    ).reshape(-1, 3, 3)
    U, _, Vt = np.linalg.svd(covariance)
    U[:, :, 2] *= np.sign(np.linalg.det(U @ Vt))[:, None]
    left = after - np.einsum("eab,eb->ea", (U @ Vt)[i], edge)
    return 0.5 * float(w @ (left**2).sum(axis=1))

"""How much a surface is distorted, whatever its position: what tells a good match from a bad one
where both reach the target."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp


@dataclass(frozen=True, eq=False)
class Edges:
    """The directed edges i → j of a mesh at rest: r_i − r_j (E, 3) and cotangent weights (E,)."""

    i: np.ndarray
    j: np.ndarray
    at_rest: np.ndarray
    weights: np.ndarray

    @classmethod
    def of(cls, rest: np.ndarray, laplacian: sp.csr_matrix) -> Edges:
        """laplacian (V, V): of `rest`, whose off-diagonal entries are −w_ij."""
        entries = laplacian.tocoo()
        off_diagonal = entries.row != entries.col
        i, j = entries.row[off_diagonal], entries.col[off_diagonal]
        w = np.maximum(-entries.data[off_diagonal], 0.0)
        return cls(i, j, rest[i] - rest[j], w)

    def laplacian(self, count: int) -> sp.csc_matrix:
        """(V, V) with these weights, none of which is negative."""
        links = sp.csc_matrix((self.weights, (self.i, self.j)), shape=(count, count))
        return sp.diags(np.asarray(links.sum(axis=1)).ravel()) - links

    def divergence(self, rotations: np.ndarray) -> np.ndarray:
        """(V, 3) Σ_j w_ij ½ (R_i + R_j) (r_i − r_j): what L x is where all edges are as wanted."""
        mean = 0.5 * (rotations[self.i] + rotations[self.j])
        wanted = self.weights[:, None] * np.einsum("eab,eb->ea", mean, self.at_rest)
        return np.stack([np.bincount(self.i, wanted[:, d], len(rotations)) for d in range(3)], 1)


def best_rotations(edges: Edges, moved: np.ndarray) -> np.ndarray:
    """(V, 3, 3): of each one-ring, the rotation nearest to what moved it."""
    w, edge, after = edges.weights, edges.at_rest, moved[edges.i] - moved[edges.j]
    covariance = np.stack(
        [
            np.bincount(edges.i, w * after[:, a] * edge[:, b], len(moved))
            for a in range(3)
            for b in range(3)
        ],
        axis=1,
    ).reshape(-1, 3, 3)
    U, _, Vt = np.linalg.svd(covariance)
    U[:, :, 2] *= np.sign(np.linalg.det(U @ Vt))[:, None]
    return np.asarray(U @ Vt)


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
    edges = Edges.of(rest, laplacian)
    after = moved[edges.i] - moved[edges.j]
    rotated = np.einsum("eab,eb->ea", best_rotations(edges, moved)[edges.i], edges.at_rest)
    return 0.5 * float(edges.weights @ ((after - rotated) ** 2).sum(axis=1))

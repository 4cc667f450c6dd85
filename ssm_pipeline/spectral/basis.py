"""Mesh → its Laplacian eigenbasis and differential operators."""

from __future__ import annotations

import numpy as np
import robust_laplacian
import scipy.sparse as sp
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from ssm_pipeline.geometry import surface
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records import CaseError, Mesh, SpectralBasis
from ssm_pipeline.spectral.gradients import gradient_operators
from ssm_pipeline.spectral.settings import SpectralSettings


def spectral_basis(mesh: Mesh, settings: SpectralSettings) -> SpectralBasis:
    """Centre a mesh, scale it to unit area, and compute what the networks read of it.

    Laplacian: cotangent weights of the intrinsic Delaunay triangulation (Sharp and Crane 2020),
    so that no weight is negative. Raises CaseError where the mesh has too few vertices.
    """
    count = settings.eigenpairs
    if len(mesh.vertices) < 2 * count:
        raise CaseError(
            mesh.case_id,
            f"the mesh has {len(mesh.vertices)} vertices; at least {2 * count} are needed for "
            f"{count} eigenpairs. Ask for more faces (meshing.faces) or fewer spectral.eigenpairs.",
        )
    frame = Similarity(
        float(np.sqrt(surface.area(mesh.vertices, mesh.faces))),
        np.eye(3),
        surface.centroid(mesh.vertices, mesh.faces),
    )
    vertices = frame.inverse().apply(mesh.vertices)
    stiffness, mass_matrix = robust_laplacian.mesh_laplacian(vertices, mesh.faces)
    mass = mass_matrix.diagonal()
    eigenvalues, eigenvectors = smallest_eigenpairs(stiffness, mass, count)
    gradient_x, gradient_y = gradient_operators(vertices, mesh.faces)
    return SpectralBasis(
        case_id=mesh.case_id,
        vertices=vertices,
        faces=mesh.faces,
        eigenvalues=eigenvalues,
        eigenvectors=eigenvectors,
        mass=mass,
        stiffness=stiffness.tocsr(),
        gradient_x=gradient_x,
        gradient_y=gradient_y,
        frame=frame,
    )


def smallest_eigenpairs(
    stiffness: sp.spmatrix, mass: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """The `count` smallest solutions of L φ = λ M φ: (K,) ascending and (V, K), ΦᵀMΦ = I.

    Solved as the ordinary problem of M^-½ L M^-½, whose shifted factor SuperLU finds in symmetric
    mode. The sign of each eigenvector is arbitrary; the start vector is fixed, so a rerun on the
    same machine gives the same bits.
    """
    root = np.sqrt(mass)
    scaled = sp.diags(1 / root) @ stiffness @ sp.diags(1 / root)
    scaled = (0.5 * (scaled + scaled.T)).tocsc()
    shift = 1e-6 * scaled.diagonal().mean()  # off the null space, or the factor is singular
    factor = splu(
        (scaled + shift * sp.identity(len(mass))).tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    eigenvalues, eigenvectors = eigsh(
        scaled,
        count,
        sigma=-shift,
        OPinv=LinearOperator(scaled.shape, matvec=factor.solve, dtype=np.float64),
        ncv=min(int(1.5 * count) + 2, len(mass)),
        v0=np.random.default_rng(0).standard_normal(len(mass)),
    )
    order = np.argsort(eigenvalues)
    return np.maximum(eigenvalues[order], 0), eigenvectors[:, order] / root[:, None]

"""The few Laplacian eigenfunctions S3M works with, in millimetres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import robust_laplacian
import scipy.sparse as sp
from scipy.sparse.linalg import eigsh

from ssm_pipeline.geometry.surface import area
from ssm_pipeline.records import CaseError, Mesh


@dataclass(frozen=True, eq=False)
class Spectrum:
    """eigenvalues (k,) 1/mm², ascending; eigenvectors (V, k) 1/mm, mass-orthonormal;
    mass (V,) mm²: each vertex's share of the area."""

    eigenvalues: np.ndarray
    eigenvectors: np.ndarray
    mass: np.ndarray


def spectrum(mesh: Mesh, count: int) -> Spectrum:
    """The `count` smallest eigenpairs of the mesh's robust Laplacian.

    Raises:
        CaseError: If the mesh has too few vertices for so many.

    Source: Sharp and Crane 2020 (tufted cover, intrinsic Delaunay).
    """
    if len(mesh.vertices) <= count + 1:
        raise CaseError(
            mesh.case_id,
            f"the mesh has {len(mesh.vertices)} vertices; S3M needs more than {count + 1} for "
            f"{count} eigenfunctions. Mesh the case more finely.",
        )
    total = area(mesh.vertices, mesh.faces)
    laplacian, mass = robust_laplacian.mesh_laplacian(mesh.vertices, mesh.faces)
    # Solved at unit area, where the spectrum is of order 10 whatever the organ, so that the small
    # negative shift (the Laplacian itself is singular) is small for every organ.
    diagonal = mass.diagonal() / total
    start = np.sqrt(diagonal) * np.linspace(1, 2, len(diagonal))  # ARPACK's own is random
    values, vectors = eigsh(
        laplacian.tocsc(), count, M=sp.diags(diagonal, format="csc"), sigma=-1e-2, v0=start
    )
    order = np.argsort(values)
    return Spectrum(
        np.maximum(values[order], 0) / total,
        vectors[:, order] / np.sqrt(total),
        diagonal * total,
    )

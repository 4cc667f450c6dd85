"""Mesh → its Laplacian eigenbasis and differential operators."""

from __future__ import annotations

import dataclasses

import numpy as np
import robust_laplacian
import scipy.sparse as sp
from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh, splu
from scipy.spatial import cKDTree

from ssm_pipeline.geometry import surface
from ssm_pipeline.geometry.topology import face_components
from ssm_pipeline.records import CaseError, Mesh, SpectralBasis, require_type
from ssm_pipeline.spectral.gradients import gradient_operators
from ssm_pipeline.spectral.settings import SpectralSettings


def spectral_basis(mesh: Mesh, settings: SpectralSettings | int | None = None) -> SpectralBasis:
    """Centre a mesh, scale it to unit area, and compute the Laplacian eigenpairs and operators.

    The Laplacian has the cotangent weights of the intrinsic Delaunay triangulation, so that no
    weight is negative. Vertices without triangles have no mass and take the values of the nearest
    vertex that has some.

    Args:
        mesh: A surface in mm.
        settings: The settings, or the number of eigenpairs K. None: a study's default.

    Returns:
        K eigenpairs, the mass, the Laplacian and the gradient operators, at unit area; `frame` maps
        unit area to millimetres.

    Raises:
        TypeError: For arguments of other types.
        CaseError: For a mesh with too few vertices, without area, or with too many pieces.

    Source: Sharp and Crane 2020, "A Laplacian for nonmanifold triangle meshes".

    Examples:
        >>> import trimesh
        >>> ball = trimesh.creation.icosphere(3, radius=40)
        >>> basis = spectral_basis(Mesh(ball.vertices, ball.faces, "ball"))
        >>> basis.eigenvectors.shape
        (642, 200)
        >>> round(float(basis.eigenvalues[1] / (8 * np.pi)), 1)  # l (l + 1) / r², at unit area
        1.0
    """
    require_type(mesh, Mesh, "mesh", "Read a file with read_mesh.")
    require_type(settings, (SpectralSettings, int, type(None)), "settings")
    if isinstance(settings, int):
        settings = SpectralSettings(eigenpairs=settings)
    count = (settings or SpectralSettings()).eigenpairs
    used = np.unique(mesh.faces)
    if len(used) < 2 * count:
        raise CaseError(
            mesh.case_id,
            f"the mesh has {len(used)} vertices; at least {2 * count} are needed for "
            f"{count} eigenpairs. Ask for more faces (meshing.faces) or fewer spectral.eigenpairs.",
        )
    _refuse_no_surface(mesh, count)
    if len(used) < len(mesh.vertices):
        rank = np.searchsorted(used, mesh.faces)
        within = spectral_basis(Mesh(mesh.vertices[used], rank, mesh.case_id), settings)
        return _with_unused_vertices(within, mesh, used)
    frame = surface.unit_area_frame(mesh.vertices, mesh.faces)
    vertices = frame.inverse().apply(mesh.vertices)
    laplacian, mass_matrix = robust_laplacian.mesh_laplacian(vertices, mesh.faces)
    mass = mass_matrix.diagonal()
    try:
        eigenvalues, eigenvectors = smallest_eigenpairs(laplacian, mass, count)
    except (ArpackError, RuntimeError) as error:  # RuntimeError: SuperLU's "singular"
        raise CaseError(
            mesh.case_id,
            f"its {count} eigenpairs can't be found ({error}). Look for triangles without area, "
            "or remesh it.",
        ) from error
    gradient_x, gradient_y = gradient_operators(vertices, mesh.faces)
    return SpectralBasis(
        case_id=mesh.case_id,
        vertices=vertices,
        faces=mesh.faces,
        eigenvalues=eigenvalues,
        eigenvectors=eigenvectors,
        mass=mass,
        laplacian=laplacian.tocsr(),
        gradient_x=gradient_x,
        gradient_y=gradient_y,
        frame=frame,
    )


def _refuse_no_surface(mesh: Mesh, count: int) -> None:
    extent = np.ptp(mesh.vertices[mesh.faces.ravel()], axis=0).max()
    if not surface.area(mesh.vertices, mesh.faces) > 1e-10 * extent**2:
        raise CaseError(
            mesh.case_id,
            f"its {len(mesh.faces)} triangles have no area; a surface is needed. Look at the file.",
        )
    pieces = len(np.unique(face_components(mesh.faces)))
    if 4 * pieces > count:  # each piece is one eigenvalue zero, and tells nothing
        raise CaseError(
            mesh.case_id,
            f"the mesh falls into {pieces} pieces, too many for {count} eigenpairs; one surface is "
            "needed. Merge vertices in the same place, or keep the largest piece.",
        )


def _with_unused_vertices(within: SpectralBasis, mesh: Mesh, used: np.ndarray) -> SpectralBasis:
    """The basis of the vertices in use, laid out for all of the mesh's."""
    count = len(mesh.vertices)
    _, nearest = cKDTree(mesh.vertices[used]).query(mesh.vertices)
    mass = np.zeros(count)
    mass[used] = within.mass
    place = sp.csr_matrix((np.ones(len(used)), (used, np.arange(len(used)))), (count, len(used)))
    return dataclasses.replace(
        within,
        vertices=within.frame.inverse().apply(mesh.vertices),
        faces=mesh.faces,
        eigenvectors=within.eigenvectors[nearest],
        mass=mass,
        laplacian=(place @ within.laplacian @ place.T).tocsr(),
        gradient_x=(place @ within.gradient_x @ place.T).tocsr(),
        gradient_y=(place @ within.gradient_y @ place.T).tocsr(),
    )


def smallest_eigenpairs(
    laplacian: sp.spmatrix, mass: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """The `count` smallest solutions of L φ = λ M φ: (K,) ascending and (V, K), ΦᵀMΦ = I.

    Solved as the ordinary problem of M^-½ L M^-½, whose shifted factor SuperLU finds in symmetric
    mode. The sign of each eigenvector is arbitrary; the start vector is fixed, so a rerun on the
    same machine gives the same bits.
    """
    root = np.sqrt(mass)
    scaled = sp.diags(1 / root) @ laplacian @ sp.diags(1 / root)
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

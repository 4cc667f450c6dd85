"""Surfaces that are not whole: where the organ ends, and where only the scan did."""

from __future__ import annotations

import numpy as np

from ssm_pipeline.geometry.closest_point import ClosestPoints
from ssm_pipeline.geometry.surface import face_normals
from ssm_pipeline.geometry.topology import boundary_edges, submesh_faces
from ssm_pipeline.records import CaseError, Mask, Mesh

# A cap's triangle looks out of the image within acos(0.7) = 45 degrees of the border's normal.
FACING = 0.7


def border_vertices(faces: np.ndarray, vertex_count: int) -> np.ndarray:
    """(V,) bool: the vertices on an open border; none for a closed surface."""
    on_border = np.zeros(vertex_count, dtype=bool)
    on_border[boundary_edges(faces).ravel()] = True
    return on_border


def lies_on_border(found: ClosestPoints, faces: np.ndarray, on_border: np.ndarray) -> np.ndarray:
    """(Q,) bool: the nearest point of a surface is at its open border, so that what was asked for
    may lie beyond it, and was not seen."""
    weighty = found.barycentric > 1e-6
    inside = weighty & ~on_border[faces[found.faces]]
    return np.asarray(~inside.any(axis=1))


def opened_at_image_border(mesh: Mesh, mask: Mask, margin_mm: float) -> Mesh:
    """The surface without the flat caps that closed it where the image ended.

    Args:
        mesh: Of that mask, in the same millimetres.
        margin_mm: A cap's triangles lie this near to the outermost voxels' centres: smoothing draws
            them in.

    Returns:
        The mesh as it is where the organ does not reach the border, else an open one.

    Raises:
        CaseError: Where nothing but caps is left.
    """
    direction = np.asarray(mask.direction)
    index = ((mesh.vertices - mask.origin_mm) @ direction) / mask.spacing_mm
    centres = index[mesh.faces].mean(axis=1)
    outward = face_normals(mesh.vertices, mesh.faces) @ direction  # along the image's axes x, y, z
    last = np.array(mask.voxels.shape[::-1]) - 1
    cap = np.zeros(len(mesh.faces), dtype=bool)
    for axis in range(3):
        margin = margin_mm / mask.spacing_mm[axis]
        for end, sign in ((0, -1), (last[axis], 1)):
            touched = mask.voxels.take(end, axis=2 - axis).any()
            near = sign * (centres[:, axis] - end) > -margin
            cap |= touched & near & (sign * outward[:, axis] > FACING)
    if not cap.any():
        return mesh
    if cap.all():
        raise CaseError(mesh.case_id, "the organ fills the image; no surface of it is seen.")
    return without_faces(mesh, cap)


def without_faces(mesh: Mesh, dropped: np.ndarray) -> Mesh:
    """The mesh without some faces (F,) bool, and without the vertices that only they had."""
    faces = mesh.faces[~dropped]
    used = np.unique(faces)
    return Mesh(mesh.vertices[used], submesh_faces(faces, used), mesh.case_id)

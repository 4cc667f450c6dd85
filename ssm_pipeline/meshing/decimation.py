"""Fewer triangles on the same surface."""

from __future__ import annotations

import fast_simplification
import numpy as np
import pymeshlab

from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.geometry.surface import face_normals, vertex_normals, volume
from ssm_pipeline.geometry.topology import euler_number, is_oriented_manifold
from ssm_pipeline.meshing.smoothing import neighbour_mean, restore_volume
from ssm_pipeline.records import CaseError, Mesh, require_type

SPREAD_ROUNDS, STEPS_A_ROUND = 4, 3


def check_decimation_available() -> None:
    """Raise RuntimeError if pymeshlab lacks its decimation, as it does without two libraries."""
    if not hasattr(pymeshlab.MeshSet, "meshing_decimation_quadric_edge_collapse"):
        raise RuntimeError(
            "pymeshlab has no quadric edge collapse: its meshing plugin did not load. Install the "
            "OpenGL libraries it needs (Debian, Ubuntu: apt install libopengl0 libgl1)."
        )


def decimate(mesh: Mesh, faces: int, fast_faces: int = 40_000) -> Mesh:
    """A closed manifold mesh with at most `faces` triangles, same topology and volume.

    Quadric edge collapse: fast-simplification down to `fast_faces`, then MeshLab with normals and
    topology kept; at last the vertices are spread evenly along the surface. A mesh that is small
    enough is returned as it is.

    Args:
        mesh: A closed manifold in mm.
        faces: The largest number of triangles.
        fast_faces: The number of triangles at which the slower, exact method takes over.

    Returns:
        The coarser mesh, with the volume of `mesh`.

    Raises:
        TypeError: For arguments of other types.
        CaseError: For a mesh that is not a closed manifold, or cannot be reduced to `faces`.

    Source: Garland and Heckbert 1997.

    Examples:
        >>> import trimesh
        >>> ball = trimesh.creation.icosphere(4)
        >>> len(ball.faces), len(decimate(Mesh(ball.vertices, ball.faces, "ball"), 2000).faces)
        (5120, 2000)
    """
    require_type(mesh, Mesh, "mesh", "Read a file with read_mesh.")
    require_type(faces, (int, np.integer), "faces")
    check_decimation_available()
    if len(mesh.faces) <= faces:
        return mesh
    if not is_oriented_manifold(mesh.faces):
        raise CaseError(
            mesh.case_id,
            f"the mesh of {len(mesh.faces)} triangles is not a closed, oriented manifold, which "
            "decimation needs. Repair it, or make it from a mask.",
        )
    reduced = reduce_fast(mesh, max(fast_faces, faces))
    coarse = _reduce_exactly(reduced, faces)
    if not is_oriented_manifold(coarse.faces) or len(coarse.faces) > 1.05 * faces:
        raise CaseError(
            mesh.case_id,
            f"decimation to {faces} triangles stopped at {len(coarse.faces)}, "
            f"{'a' if is_oriented_manifold(coarse.faces) else 'not a'} closed manifold. Ask for "
            "more triangles, or for more smoothing.",
        )
    vertices = spread_vertices(coarse, reduced)
    vertices = restore_volume(vertices, coarse.faces, volume(mesh.vertices, mesh.faces))
    return Mesh(vertices, coarse.faces, mesh.case_id)


def spread_vertices(coarse: Mesh, surface: Mesh) -> np.ndarray:
    """(V, 3): vertices of `coarse` moved along `surface` towards the mean of their neighbours.

    A few tangential steps, then back onto the surface, a few times over. Vertices of a triangle
    that a round would turn around keep their places in it.
    """
    mean = neighbour_mean(coarse.faces, len(coarse.vertices))
    vertices = coarse.vertices
    for _ in range(SPREAD_ROUNDS):
        normals = vertex_normals(vertices, coarse.faces)
        moved = vertices
        for _ in range(STEPS_A_ROUND):
            move = 0.5 * (mean @ moved - moved)
            moved = moved + move - np.einsum("vd,vd->v", move, normals)[:, None] * normals
        moved = closest_points(moved, surface.vertices, surface.faces).points
        before, after = (face_normals(points, coarse.faces) for points in (vertices, moved))
        turned = coarse.faces[np.einsum("fd,fd->f", before, after) <= 0]
        moved[turned] = vertices[turned]
        vertices = moved
    return vertices


def reduce_fast(mesh: Mesh, faces: int) -> Mesh:
    """fast-simplification to `faces` triangles, or the mesh itself where that fails.

    Faster than MeshLab, with worse triangles: a first step, never the last.
    """
    if len(mesh.faces) <= faces:
        return mesh
    vertices, triangles = fast_simplification.simplify(
        mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32), target_count=faces
    )
    # It does not promise to keep the topology: where it does not, MeshLab starts from the full
    # mesh, and takes longer.
    kept = is_oriented_manifold(triangles) and euler_number(triangles) == euler_number(mesh.faces)
    return Mesh(vertices, triangles, mesh.case_id) if kept else mesh


def _reduce_exactly(mesh: Mesh, faces: int) -> Mesh:
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(mesh.vertices, mesh.faces.astype(np.int32)))
    meshes.meshing_decimation_quadric_edge_collapse(
        targetfacenum=faces, preservenormal=True, preservetopology=True
    )
    result = meshes.current_mesh()
    return Mesh(result.vertex_matrix(), result.face_matrix(), mesh.case_id)

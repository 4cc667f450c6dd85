"""Surface → Mesh: repaired, and triangulated as densely as the study's other meshes."""

from __future__ import annotations

import numpy as np

from ssm_pipeline.geometry.surface import volume
from ssm_pipeline.geometry.topology import directed_edges
from ssm_pipeline.meshing.decimation import decimate, reduce_fast
from ssm_pipeline.meshing.handles import Handle, cut_handles
from ssm_pipeline.meshing.loss_texts import handle_texts
from ssm_pipeline.meshing.quality import MeshQuality, measure_surface_quality
from ssm_pipeline.meshing.repair import repair
from ssm_pipeline.meshing.settings import MeshingSettings
from ssm_pipeline.records import Mesh, Surface


def mesh_from_surface(surface: Surface, settings: MeshingSettings) -> tuple[Mesh, MeshQuality]:
    """Repair, cut handles, and bring to the wanted number of triangles; nothing is smoothed.

    The quality is against the repaired surface.

    Raises:
        CaseError: Where no closed manifold surface results.
    """
    whole, told = repair(surface, settings.hole_percent)
    fine = reduce_fast(whole, settings.fast_faces)
    handles: tuple[Handle, ...] = ()
    if settings.cut_handles:
        fine, handles = cut_handles(fine)
    while len(fine.faces) < 2 * settings.faces:  # twice: decimation then places them evenly
        fine = subdivide(fine)
    mesh = decimate(fine, settings.faces)
    told += handle_texts(handles, volume(whole.vertices, whole.faces))
    return mesh, measure_surface_quality(mesh, whole, len(handles), told)


def subdivide(mesh: Mesh) -> Mesh:
    """Every triangle cut into four at the middles of its edges: the same surface.

    >>> tetrahedron = Mesh(np.eye(4)[:, :3], np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]),
    ...                    "a")
    >>> subdivide(tetrahedron).faces.shape, subdivide(tetrahedron).vertices.shape
    ((16, 3), (10, 3))
    """
    edges = np.sort(directed_edges(mesh.faces), axis=1)
    unique, middle = np.unique(edges, axis=0, return_inverse=True)
    ab, bc, ca = len(mesh.vertices) + middle.reshape(3, -1)
    a, b, c = mesh.faces.T
    faces = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return Mesh(
        np.concatenate([mesh.vertices, mesh.vertices[unique].mean(axis=1)]),
        np.concatenate([np.column_stack(corners) for corners in faces]),
        mesh.case_id,
    )

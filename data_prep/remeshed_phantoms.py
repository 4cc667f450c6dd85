"""A matching benchmark with exact truth: phantoms, each shape with a triangulation of its own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pymeshlab
from scipy.spatial import cKDTree

from data_prep.matching_folder import MatchingSet
from ssm_pipeline.geometry.surface import area
from ssm_pipeline.records import Mesh, PhantomTruth, StudyError


def remeshed_phantoms(truth: PhantomTruth, vertex_counts: Sequence[int]) -> MatchingSet:
    """Remesh each phantom's true surface for itself, to about the given number of vertices.

    The true points are the common template: each corresponds to the nearest vertex of the
    remeshed surface, so the truth is exact up to half an edge. Give different counts, or no two
    shapes will differ in density. Raises StudyError if there isn't one count a case.
    """
    if len(vertex_counts) != len(truth.case_ids):
        raise StudyError(
            f"{len(vertex_counts)} vertex counts given for {len(truth.case_ids)} phantoms; "
            "one a case is needed."
        )
    meshes, correspondences = [], []
    for case_id, points, count in zip(truth.case_ids, truth.vertices, vertex_counts, strict=True):
        mesh = _isotropic(Mesh(points, truth.faces, case_id), count)
        meshes.append(mesh)
        correspondences.append(cKDTree(mesh.vertices).query(points)[1].astype(np.int64))
    return MatchingSet(tuple(meshes), tuple(correspondences))


def _isotropic(mesh: Mesh, vertex_count: int) -> Mesh:
    """Triangles of one size, as near to equilateral as the surface allows."""
    # An equilateral triangle of edge e covers √3/4 e², and a closed mesh has two a vertex.
    edge = np.sqrt(area(mesh.vertices, mesh.faces) / vertex_count * 2 / np.sqrt(3))
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(mesh.vertices, mesh.faces))
    meshes.meshing_isotropic_explicit_remeshing(targetlen=pymeshlab.PureValue(edge), iterations=6)
    result = meshes.current_mesh()
    return Mesh(result.vertex_matrix(), result.face_matrix(), mesh.case_id)

"""Give a surface a triangulation of its own, with the truth carried over."""

from __future__ import annotations

import numpy as np
import pymeshlab
from scipy.spatial import cKDTree

from ssm_pipeline.geometry.surface import area
from ssm_pipeline.records import Mesh


def remeshed(mesh: Mesh, vertex_count: int) -> Mesh:
    """About `vertex_count` vertices; triangles of one size, as near to equilateral as they fit."""
    # An equilateral triangle of edge e covers √3/4 e², and a closed mesh has two a vertex.
    edge = np.sqrt(area(mesh.vertices, mesh.faces) / vertex_count * 2 / np.sqrt(3))
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(mesh.vertices, mesh.faces))
    # No edge is kept for being sharp: a crease would be triangulated alike in every shape. More
    # iterations wear off what is as thin as an edge is long, such as thumbs.
    meshes.meshing_isotropic_explicit_remeshing(
        targetlen=pymeshlab.PureValue(edge), iterations=3, featuredeg=180, checksurfdist=False
    )
    result = meshes.current_mesh()
    return Mesh(result.vertex_matrix(), result.face_matrix(), mesh.case_id)


def renumbered(mesh: Mesh, generator: np.random.Generator) -> Mesh:
    """The same surface, its vertices and faces in random order: remeshing then goes another way."""
    new_number = generator.permutation(len(mesh.vertices))
    vertices = np.empty_like(mesh.vertices)
    vertices[new_number] = mesh.vertices
    return Mesh(vertices, generator.permutation(new_number[mesh.faces]), mesh.case_id)


def nearest_vertices(mesh: Mesh, points: np.ndarray) -> np.ndarray:
    """(R,) int: for points (R, 3) on the surface the vertex nearest to each."""
    result: np.ndarray = cKDTree(mesh.vertices).query(points)[1].astype(np.int64)
    return result

"""S3M's points joined to a surface, so that it is scored like any other method.

S3M matches point clouds. A cloud's distance to an organ never falls below the spacing of its
points, which would hide most of what a comparison is for.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from ssm_pipeline.geometry.topology import directed_edges
from ssm_pipeline.records import Mesh


def joining_faces(mesh: Mesh, points: np.ndarray) -> np.ndarray:
    """Triangles (F, 3) between vertices of a mesh: the dual of their geodesic Voronoi cells.

    a triangle of the mesh that meets three cells joins their three points, in its orientation.

    Args:
        points: (n,) int, the vertices kept. Every vertex of the mesh belongs to the nearest kept
            one.

    Returns:
        Indices into `points`.

    Source: Peyré and Cohen 2006, geodesic remeshing.
    """
    edges = directed_edges(mesh.faces)
    lengths = np.linalg.norm(mesh.vertices[edges[:, 0]] - mesh.vertices[edges[:, 1]], axis=1)
    count = len(mesh.vertices)
    graph = csr_matrix((lengths, (edges[:, 0], edges[:, 1])), shape=(count, count))
    _, _, nearest = dijkstra(graph, indices=points, min_only=True, return_predecessors=True)
    cell = np.empty(count, dtype=np.int64)
    cell[points] = np.arange(len(points))
    corners = cell[nearest[mesh.faces]]
    distinct = (
        (corners[:, 0] != corners[:, 1])
        & (corners[:, 1] != corners[:, 2])
        & (corners[:, 2] != corners[:, 0])
    )
    found = corners[distinct]
    # Two cells that touch along two separate lines give a triangle twice: once is enough.
    turned = np.stack([np.roll(f, -f.argmin()) for f in found]) if len(found) else found
    return np.unique(turned, axis=0)

"""A matching benchmark with exact truth: phantoms, each shape with a triangulation of its own."""

from __future__ import annotations

from collections.abc import Sequence

from ssm_pipeline.data_prep.matching_sets.matching_set import MatchingSet
from ssm_pipeline.data_prep.synthetic.remeshing import nearest_vertices, remeshed
from ssm_pipeline.records import Mesh, PhantomTruth, StudyError


def remeshed_phantoms(truth: PhantomTruth, vertex_counts: Sequence[int]) -> MatchingSet:
    """Remesh each phantom's true surface for itself, to about the given number of vertices.

    The true points are the common template: each corresponds to the nearest vertex of the remeshed
    surface, so the truth is exact up to half an edge. Give different counts, or no two shapes will
    differ in density.

    Raises:
        StudyError: If there isn't one count a case.
    """
    if len(vertex_counts) != len(truth.case_ids):
        raise StudyError(
            f"{len(vertex_counts)} vertex counts given for {len(truth.case_ids)} phantoms; "
            "one per case is needed."
        )
    meshes, correspondences = [], []
    for case_id, points, count in zip(truth.case_ids, truth.vertices, vertex_counts, strict=True):
        mesh = remeshed(Mesh(points, truth.faces, case_id), count)
        meshes.append(mesh)
        correspondences.append(nearest_vertices(mesh, points))
    return MatchingSet(tuple(meshes), tuple(correspondences))

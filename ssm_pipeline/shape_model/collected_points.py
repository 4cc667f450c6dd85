"""Correspondences of a cohort → shapes on one template."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ssm_pipeline.records import CorrespondedShapes, Correspondence, Mesh


def collect(
    template: Mesh, correspondences: Sequence[Correspondence], meshes: Sequence[Mesh]
) -> CorrespondedShapes:
    """Each case's surface as sampled by the template's vertices, in the case's own millimetres.

    `meshes` in the order of `correspondences`; the template itself is among the cases, matched to
    itself by its own vertices.
    """
    shapes = points_on_cases(correspondences, meshes, template.faces)
    vertices = np.array(shapes.vertices)
    for index, case_id in enumerate(shapes.case_ids):
        if case_id == template.case_id:
            vertices[index] = template.vertices
    return dataclasses.replace(shapes, vertices=vertices)


def points_on_cases(
    correspondences: Sequence[Correspondence], meshes: Sequence[Mesh], faces: np.ndarray
) -> CorrespondedShapes:
    """Each case's surface where its correspondence says, the template's among them.

    `meshes` in the order of `correspondences`, which are all of one template; faces: that one's.
    """
    points = [match.points_on(mesh) for match, mesh in zip(correspondences, meshes, strict=True)]
    return CorrespondedShapes(
        vertices=np.stack(points),
        faces=faces,
        case_ids=tuple(match.case_id for match in correspondences),
        template_id=correspondences[0].template_id,
    )

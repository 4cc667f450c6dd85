"""Correspondences of a cohort → shapes on one template."""

from __future__ import annotations

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
    shapes = [
        template.vertices if match.case_id == template.case_id else match.points_on(mesh)
        for match, mesh in zip(correspondences, meshes, strict=True)
    ]
    return CorrespondedShapes(
        vertices=np.stack(shapes),
        faces=template.faces,
        case_ids=tuple(match.case_id for match in correspondences),
        template_id=template.case_id,
    )

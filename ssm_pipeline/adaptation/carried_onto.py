"""A shape laid on a case → the points of the case's surface that it names."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.records import Correspondence, Mesh, SpectralBasis


def carried_onto(
    case: Mesh | SpectralBasis,
    template_id: str,
    laid: np.ndarray,
    fitted: np.ndarray,
    start: str = "rigid",
    start_reason: str = "",
) -> Correspondence:
    """Every point's nearest place on the case's triangles, and the case's nearest vertex.

    Args:
        laid: (V, 3) in the space of `case.vertices`
        fitted: The same in millimetres.
    """
    on_case = closest_points(laid, case.vertices, case.faces)
    _, nearest_vertex = cKDTree(case.vertices).query(laid)
    return Correspondence(
        template_id=template_id,
        case_id=case.case_id,
        case_faces=on_case.faces,
        barycentric=on_case.barycentric,
        nearest_vertex=nearest_vertex.astype(np.int64),
        fitted=fitted,
        start=start,
        start_reason=start_reason,
    )

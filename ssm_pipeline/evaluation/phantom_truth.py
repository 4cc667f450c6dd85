"""Against the truth of a synthetic cohort: correspondence errors, recovered modes, the floor.

Written apart from what makes the phantoms: nothing here knows how they were shaped, and only the
truth's points are read.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.linalg import orth, subspace_angles

from ssm_pipeline.geometry.barycentric import interpolated
from ssm_pipeline.geometry.closest_point import ClosestPoints, closest_points
from ssm_pipeline.geometry.geodesics import geodesics_between
from ssm_pipeline.geometry.rigid import best_similarity
from ssm_pipeline.geometry.surface import area
from ssm_pipeline.records import CorrespondedShapes, Mesh, PhantomTruth, StudyError
from ssm_pipeline.shape_model.alignment import align
from ssm_pipeline.shape_model.model import ShapeModel


def on_reference(template: Mesh, truth: PhantomTruth) -> ClosestPoints:
    """The template mesh's vertices on the truth's reference surface: which points they are.

    The template mesh was made from a mask of one of the cases; each of its vertices is taken for
    the true surface point nearest to it in that case.

    Raises:
        StudyError: For a template that is none of the phantom's cases.
    """
    if template.case_id not in truth.case_ids:
        raise StudyError(
            f"the template {template.case_id} is not among the phantom's {len(truth.case_ids)} "
            "cases, so its vertices' true points are unknown. Use a phantom case as template."
        )
    surface = truth.vertices[truth.case_ids.index(template.case_id)]
    return closest_points(template.vertices, surface, truth.faces)


def true_correspondence(
    template: Mesh, truth: PhantomTruth, case_ids: tuple[str, ...]
) -> CorrespondedShapes:
    """Where every template vertex truly lies in each case: shapes on the template's faces.

    The model built from these is the floor: no matcher can give a better one than the truth
    (score it with `evaluate.evaluate_method`).
    """
    reference = on_reference(template, truth)
    vertices = _carried(reference, _surfaces(truth, case_ids), truth.faces)
    return CorrespondedShapes(vertices, template.faces, case_ids, template.case_id)


def correspondence_errors(
    predicted: CorrespondedShapes, template: Mesh, truth: PhantomTruth
) -> pd.DataFrame:
    """Geodesic error of every case's correspondences.

    Predicted points are carried onto the true surface (nearest point), and the geodesic there is
    measured between them and the true points (see `geodesics.geodesics_between` for how). Points
    that the case's or the template's field of view does not show are left out: no method can know
    where they are.

    Args:
        predicted: (N, V, 3) mm, in each case's own space (not aligned), on the template's vertices.

    Returns:
        A row per case but the template: case_id, geodesic_mm, geodesic_median_mm, geodesic_p95_mm,
        geodesic_x100 (mean over √area, ×100), off_surface_mm (mean distance of the predicted points
        from the true surface), scored_percent (of the template's vertices).
    """
    reference = on_reference(template, truth)
    seen = seen_in(reference, truth, (template.case_id, *predicted.case_ids))
    in_template, in_cases = seen[0], seen[1:]
    rows = []
    for case_id, points, in_case in zip(
        predicted.case_ids, predicted.vertices, in_cases, strict=True
    ):
        if case_id == template.case_id:
            continue
        surface, scored = _surfaces(truth, (case_id,))[0], in_template & in_case
        true = ClosestPoints(
            _carried(reference, surface[None], truth.faces)[0][scored],
            reference.faces[scored],
            reference.barycentric[scored],
            np.zeros(int(scored.sum())),
        )
        found = closest_points(points[scored], surface, truth.faces)
        errors = geodesics_between(surface, truth.faces, found, true)
        rows.append(
            {
                "case_id": case_id,
                "geodesic_mm": errors.mean(),
                "geodesic_median_mm": np.median(errors),
                "geodesic_p95_mm": np.percentile(errors, 95),
                "geodesic_x100": 100 * errors.mean() / np.sqrt(area(surface, truth.faces)),
                "off_surface_mm": found.distances.mean(),
                "scored_percent": 100 * scored.mean(),
            }
        )
    return pd.DataFrame(rows)


def variance_kept(
    predicted: CorrespondedShapes, template: Mesh, truth: PhantomTruth, with_scale: bool = False
) -> float:
    """Variance of a method's shapes over that of the true ones, pose removed from both.

    A method that flattens, drawing all cases towards one shape, keeps less than 1 and so wins
    specificity; one that scatters its points keeps more. Both are summed over the template's
    vertices that every case's field of view shows.

    Args:
        predicted: (N, V, 3) mm, in each case's own space. Raises StudyError for other cases.
    """
    true = true_correspondence(template, truth, predicted.case_ids)
    seen = seen_in(on_reference(template, truth), truth, truth.case_ids).all(axis=0)
    own, known = (align(s, with_scale)[0].vertices[:, seen] for s in (predicted, true))
    return float(own.var(axis=0).sum() / known.var(axis=0).sum())


def seen_in(points: ClosestPoints, truth: PhantomTruth, case_ids: tuple[str, ...]) -> np.ndarray:
    """(N, V) bool: which of the points on the reference each case's field of view shows."""
    if truth.seen is None:
        return np.ones((len(case_ids), len(points.faces)), bool)
    shown = truth.seen[[truth.case_ids.index(case_id) for case_id in case_ids]]
    result: np.ndarray = np.all(shown[:, truth.faces[points.faces]], axis=2)
    return result


def recovered_modes(
    model: ShapeModel, floor: ShapeModel, template: Mesh, truth: PhantomTruth
) -> pd.DataFrame:
    """How much of the true modes' span the model's leading modes hold, and of their variance.

    The true modes, the changes that small scores make, are read at the template's vertices and
    turned into the model's frame. What of them is a rigid motion is taken out, since alignment
    takes it out of the model too.

    Args:
        model: The method's.
        floor: The model of `true_correspondence`. Both on the template's vertices, unscaled.

    Returns:
        A row per true mode, m = 1 … M: mode; angle_degrees, the m-th principal angle between the
        span of the model's first M modes and the true span (0: recovered, 90: missed), and
        floor_angle_degrees, the floor model's; variance_mm2, and floor_variance_mm2.
    """
    reference = on_reference(template, truth)
    mean = _carried(reference, truth.mean[None], truth.faces)[0]
    displaced = _carried(reference, truth.modes, truth.faces)
    count = min(len(truth.modes), model.mode_count, floor.mode_count)
    frame = {id(which): best_similarity(mean, which.mean) for which in (model, floor)}
    angles = {}
    for name, which in (("angle_degrees", model), ("floor_angle_degrees", floor)):
        true_modes = displaced @ frame[id(which)].rotation.T
        true_span = _without_rigid(true_modes, which.mean)
        span = which.modes[:count].reshape(count, -1).T
        angles[name] = np.degrees(np.sort(subspace_angles(span, true_span)))[:count]
    return pd.DataFrame(
        {
            "mode": np.arange(1, count + 1),
            **angles,
            "variance_mm2": model.variances[:count],
            "floor_variance_mm2": floor.variances[:count],
        }
    )


def _surfaces(truth: PhantomTruth, case_ids: tuple[str, ...]) -> np.ndarray:
    """(N, R, 3) the true surfaces of these cases, in their own millimetres."""
    unknown = [case_id for case_id in case_ids if case_id not in truth.case_ids]
    if unknown:
        raise StudyError(
            f"cases {', '.join(unknown[:5])} are not in the phantom's truth, which holds "
            f"{len(truth.case_ids)} cases. Evaluate against the truth of the same cohort."
        )
    return truth.vertices[[truth.case_ids.index(case_id) for case_id in case_ids]]


def _carried(points: ClosestPoints, fields: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(N, R, 3) values at the reference's vertices → (N, V, 3) at the template's."""
    return interpolated(fields, faces[points.faces], points.barycentric)


def _without_rigid(modes: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """(3V, M') orthonormal basis of the modes' span beside the rigid motions of `shape`."""
    centred = shape - shape.mean(axis=0)
    axes = np.eye(3)
    translations = [np.broadcast_to(axis, shape.shape) for axis in axes]
    turns = [np.cross(axis, centred) for axis in axes]
    rigid = orth(np.stack([*translations, *turns]).reshape(6, -1).T)
    flat = modes.reshape(len(modes), -1).T
    result: np.ndarray = orth(flat - rigid @ (rigid.T @ flat))
    return result

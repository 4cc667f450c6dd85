"""How good the correspondences are before any PCA, so that a collapsed matcher can't look good."""

from __future__ import annotations

import numpy as np
import pandas as pd

from ssm_pipeline.evaluation.aligned_cohort import AlignedCohort
from ssm_pipeline.evaluation.settings import EvaluationSettings
from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.geometry.distances import PointTarget, symmetric
from ssm_pipeline.geometry.surface import area, face_normals, sample_points
from ssm_pipeline.records import Mesh


def correspondence_quality(
    cohort: AlignedCohort,
    settings: EvaluationSettings,
    generator: np.random.Generator,
    fitted: np.ndarray | None = None,
) -> pd.DataFrame:
    """Fit, orientation, coverage and bijectivity of each case's template.

    Args:
        fitted: (N, V, 3) mm, the same before they were carried onto the cases' surfaces; None:
            never fitted, and the columns of it are NaN.

    Returns:
        One row per case: to_case_mm, to_case_hd95_mm template vertices to the case's triangles
        from_case_mm, from_case_hd95_mm case vertices to the template's triangles surface_mm,
        hd95_mm mean of the two means, larger of the two HD95 flipped_percent share of the
        template's triangles that face against the case's surface at the point nearest to their
        centre uncovered_percent share of the case's area with no template vertex within
        `coverage_mm` coverage_mm settings.coverage_edges mean edges of an even triangulation of the
        case by V vertices distinct_percent different case vertices that are nearest to a template
        vertex, over min(V, V_case): how many there could be round_trip_mm template vertex → nearest
        case vertex → nearest template vertex: mean distance between the first and the last, on the
        mean shape fitted_surface_mm, fitted_hd95_mm, fitted_flipped_percent the first three of the
        shapes as fitted: points that were carried onto a case lie on it however bad the fit was.
    """
    shapes, reference = cohort.shapes, cohort.shapes.vertices.mean(axis=0)
    rows = [
        _fit(vertices, shapes.faces, mesh)
        | _coverage(vertices, mesh, settings, generator)
        | _bijectivity(vertices, reference, mesh)
        | _before_carrying(None if fitted is None else fitted[case], shapes.faces, mesh)
        for case, (vertices, mesh) in enumerate(zip(shapes.vertices, cohort.meshes, strict=True))
    ]
    table = pd.DataFrame(rows)
    table.insert(0, "case_id", list(shapes.case_ids))
    return table


def flipped_share(vertices: np.ndarray, faces: np.ndarray, mesh: Mesh) -> float:
    """Share (0 … 1) of triangles that face against the case's surface, or have no area."""
    normals = face_normals(vertices, faces)
    nearest = closest_points(vertices[faces].mean(axis=1), mesh.vertices, mesh.faces)
    beneath = face_normals(mesh.vertices, mesh.faces)[nearest.faces]
    return float((np.einsum("fd,fd->f", normals, beneath) <= 0).mean())


def _fit(vertices: np.ndarray, faces: np.ndarray, mesh: Mesh) -> dict[str, float]:
    to_case = closest_points(vertices, mesh.vertices, mesh.faces).distances
    from_case = closest_points(mesh.vertices, vertices, faces).distances
    both = symmetric(to_case, from_case)
    return {
        "to_case_mm": to_case.mean(),
        "to_case_hd95_mm": np.percentile(to_case, 95),
        "from_case_mm": from_case.mean(),
        "from_case_hd95_mm": np.percentile(from_case, 95),
        "surface_mm": both.mean,
        "hd95_mm": both.hd95,
        "flipped_percent": 100 * flipped_share(vertices, faces, mesh),
    }


def _before_carrying(fitted: np.ndarray | None, faces: np.ndarray, mesh: Mesh) -> dict[str, float]:
    names = ("surface_mm", "hd95_mm", "flipped_percent")
    found = dict.fromkeys(names, np.nan) if fitted is None else _fit(fitted, faces, mesh)
    return {f"fitted_{name}": found[name] for name in names}


def _coverage(
    vertices: np.ndarray,
    mesh: Mesh,
    settings: EvaluationSettings,
    generator: np.random.Generator,
) -> dict[str, float]:
    # V vertices make about 2V equilateral triangles of area √3/4 e². The template's own edges
    # would not do: they shrink with a collapse, and so would the threshold.
    even_edge = np.sqrt(2 * area(mesh.vertices, mesh.faces) / (np.sqrt(3) * len(vertices)))
    threshold = settings.coverage_edges * even_edge
    samples = sample_points(mesh.vertices, mesh.faces, max(settings.points, 4000), generator)
    uncovered = PointTarget.of(vertices).distances_to(samples) > threshold
    return {"uncovered_percent": 100 * float(uncovered.mean()), "coverage_mm": threshold}


def _bijectivity(vertices: np.ndarray, reference: np.ndarray, mesh: Mesh) -> dict[str, float]:
    _, on_case = PointTarget.of(mesh.vertices).tree.query(vertices.astype(np.float32))
    _, back = PointTarget.of(vertices).tree.query(mesh.vertices[on_case].astype(np.float32))
    possible = min(len(vertices), len(mesh.vertices))
    return {
        "distinct_percent": 100 * len(np.unique(on_case)) / possible,
        "round_trip_mm": float(np.linalg.norm(reference - reference[back], axis=1).mean()),
    }

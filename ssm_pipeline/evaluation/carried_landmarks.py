"""Landmarks placed on every case, carried by the correspondences from case to case."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from ssm_pipeline.evaluation.pair_bootstrap import means_over_pairs
from ssm_pipeline.geometry.barycentric import interpolated
from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.records import CorrespondedShapes


def carried_landmarks(
    shapes: CorrespondedShapes, positions: Mapping[str, np.ndarray], names: Sequence[str]
) -> pd.DataFrame:
    """The distance between each landmark carried from another case and the case's own.

    Args:
        shapes: (N, V, 3) mm, in each case's own space.
        positions: Case id → (L, 3) mm in the case's own space, for two cases or more.
        names: (L,).

    Returns:
        A row per ordered pair and landmark: from_case_id, case_id, landmark, error_mm. A landmark
        is carried from the surface point nearest to it; how far it lies from the surface is part of
        the error.
    """
    vertices = dict(zip(shapes.case_ids, shapes.vertices, strict=True))
    placed = [case_id for case_id in shapes.case_ids if case_id in positions]
    rows = []
    for source in placed:
        nearest = closest_points(positions[source], vertices[source], shapes.faces)
        corners = shapes.faces[nearest.faces]
        for target in placed:
            if target == source:
                continue
            carried = interpolated(vertices[target], corners, nearest.barycentric)
            errors = np.linalg.norm(carried - positions[target], axis=1)
            rows += [
                {"from_case_id": source, "case_id": target, "landmark": name, "error_mm": error}
                for name, error in zip(names, errors, strict=True)
            ]
    return pd.DataFrame(rows)


def landmark_cases(pairs: pd.DataFrame) -> pd.DataFrame:
    """A row per case and landmark: mean over all other cases' landmarks carried to it."""
    keys = ["case_id", "landmark"]
    return pairs.groupby(keys, sort=False)["error_mm"].mean().reset_index()


def landmark_means(
    pairs: Mapping[str, pd.DataFrame],
    baseline: str,
    draws: int,
    generator: np.random.Generator,
    patients: Mapping[str, str] | None = None,
) -> pd.DataFrame:
    """A row per method: error_mm over all pairs and landmarks, error_difference_mm to the baseline.

    Each with _low and _high before the unit: 95 % intervals over the cases, a patient's (case →
    patient) together.
    """
    keys = ["from_case_id", "case_id"]
    by_pair = {
        method: table.groupby(keys)["error_mm"].mean().reset_index()
        for method, table in pairs.items()
    }
    columns = {"error_mm": "error_difference_mm"}
    return means_over_pairs(by_pair, columns, baseline, draws, generator, patients)

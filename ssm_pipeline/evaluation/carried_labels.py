"""Anatomical labels carried by the correspondences from case to case, against each case's own.

Labels drawn by anatomists know nothing of geometry, so that they judge all methods alike, also on
real organs. A floor remains, as the border between two parts varies on its own: only differences
between methods on the same pairs count.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from ssm_pipeline.evaluation.pair_bootstrap import means_over_pairs
from ssm_pipeline.geometry.barycentric import interpolated
from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.geometry.surface import area, sample_surface
from ssm_pipeline.records import CorrespondedShapes, Mesh, SurfaceLabels


def carried_labels(
    shapes: CorrespondedShapes,
    meshes: Sequence[Mesh],
    labels: Sequence[SurfaceLabels],
    points: int,
    generator: np.random.Generator,
) -> pd.DataFrame:
    """Labels of every case laid on every other: how much of its surface they get wrong.

    Args:
        shapes: (N, V, 3) mm, in each case's own space.
        meshes, labels: N, in the order of the shapes and in the same space.
        points: Even samples of each case's surface, at which labels are compared.

    Returns:
        A row per ordered pair, from_case_id ≠ case_id: disagree_percent, the share of the target's
        area where the carried label is not its own; border_mm, that area over the length of the
        target's own border: by how much the border is misplaced, on average along it (NaN without a
        border).
    """
    values = np.unique(np.concatenate([one.values for one in labels]))
    shares = [_in_columns(one, values) for one in labels]
    carried = np.stack(
        [
            _at(vertices, mesh.vertices, mesh.faces, own)
            for vertices, mesh, own in zip(shapes.vertices, meshes, shares, strict=True)
        ]
    )
    rows = []
    for target, (mesh, own) in enumerate(zip(meshes, shares, strict=True)):
        face, weights = sample_surface(mesh.vertices, mesh.faces, points, generator)
        samples = interpolated(mesh.vertices, mesh.faces[face], weights)
        own_label = interpolated(own, mesh.faces[face], weights).argmax(axis=1)
        place = closest_points(samples, shapes.vertices[target], shapes.faces)
        corners = shapes.faces[place.faces]
        length = border_length(mesh.vertices, mesh.faces, own)
        whole = area(mesh.vertices, mesh.faces)
        for source in range(len(meshes)):
            if source == target:
                continue
            label = interpolated(carried[source], corners, place.barycentric).argmax(axis=1)
            wrong = float((label != own_label).mean())
            rows.append(
                {
                    "from_case_id": shapes.case_ids[source],
                    "case_id": shapes.case_ids[target],
                    "disagree_percent": 100 * wrong,
                    "border_mm": wrong * whole / length if length > 0 else np.nan,
                }
            )
    return pd.DataFrame(rows)


def border_length(vertices: np.ndarray, faces: np.ndarray, shares: np.ndarray) -> float:
    """Length, in the vertices' unit, of the lines between the parts of a surface.

    Args:
        shares: (V, L): a point belongs to the part of largest share; linear over each triangle.
    """
    total = 0.0
    for part in range(shares.shape[1]):
        others = np.delete(shares, part, axis=1)
        if others.shape[1] == 0:
            return 0.0
        ahead = (shares[:, part] - others.max(axis=1))[faces]  # (F, 3)
        within = ahead >= 0
        crossed = within.any(axis=1) & ~within.all(axis=1)
        ahead, within, corners = ahead[crossed], within[crossed], vertices[faces[crossed]]
        # Two lines of the triangle are crossed: those at the corner that stands alone.
        alone = np.where(within.sum(axis=1) == 1, within.argmax(axis=1), within.argmin(axis=1))
        row = np.arange(len(alone))
        ends = []
        for step in (1, 2):
            other = (alone + step) % 3
            t = ahead[row, alone] / (ahead[row, alone] - ahead[row, other])
            ends.append(
                corners[row, alone] + t[:, None] * (corners[row, other] - corners[row, alone])
            )
        total += float(np.linalg.norm(ends[0] - ends[1], axis=1).sum())
    return total / 2  # each line is the edge of two parts


def label_means(
    pairs: Mapping[str, pd.DataFrame],
    baseline: str,
    draws: int,
    generator: np.random.Generator,
    patients: Mapping[str, str] | None = None,
) -> pd.DataFrame:
    """A row per method: means over all ordered pairs, with 95 % intervals over the cases.

    Args:
        pairs: Method → `carried_labels`, of the same cases.
        patients: Case → patient.

    Returns:
        Method, cases, disagree_percent with _low and _high before the unit, border_mm likewise, and
        border_difference_mm to the baseline, pair by pair, likewise.
    """
    columns = {"disagree_percent": "", "border_mm": "border_difference_mm"}
    return means_over_pairs(pairs, columns, baseline, draws, generator, patients)


def label_cases(pairs: pd.DataFrame) -> pd.DataFrame:
    """A row per case: means over all other cases' labels laid on it."""
    numbers = ["disagree_percent", "border_mm"]
    return pairs.groupby("case_id", sort=False)[numbers].mean().reset_index()


def _in_columns(labels: SurfaceLabels, values: np.ndarray) -> np.ndarray:
    """(V, L) shares of all labels of the cohort; zero for those that the case lacks."""
    shares = np.zeros((len(labels.shares), len(values)))
    shares[:, np.searchsorted(values, labels.values)] = labels.shares
    return shares


def _at(
    points: np.ndarray, vertices: np.ndarray, faces: np.ndarray, shares: np.ndarray
) -> np.ndarray:
    """(V, L) shares at the surface's points nearest to `points` (V, 3)."""
    nearest = closest_points(points, vertices, faces)
    return interpolated(shares, faces[nearest.faces], nearest.barycentric)

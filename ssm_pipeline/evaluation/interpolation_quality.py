"""How good an interpolation is, against going straight between the same corresponding points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ssm_pipeline.evaluation.matching_quality import conformal_distortion
from ssm_pipeline.geometry.surface import volume
from ssm_pipeline.geometry.topology import boundary_edges, edges
from ssm_pipeline.records import ShapePath

WORST = 20.0  # a triangle distorted more counts so: one that collapses shall not be the mean
NEAR = 0.1  # above 2: distortion that counts as nearly none
LIMIT = 1.0  # above 2: the range of the curve


def interpolation_quality(path: ShapePath) -> pd.DataFrame:
    """A row per stored time: what X(t, t) does to the template, and what the straight line does.

    X(t, t) begins as the template and ends as the path's own points of the case X(1, 1), which the
    model's correspondence, of another start and groupwise rounds, need not equal; so does the
    straight line (1 − t) X(0, 0) + t X(1, 1). Columns, and each again with `straight_`:
        t
        conformal_distortion       mean over the triangles of σ₁/σ₂ + σ₂/σ₁ against t = 0 (2 where
                                   angles are kept, whatever the size; at most WORST)
        conformal_near_2_percent   triangles with at most 2 + NEAR
        volume_change_percent      against an even change from the first volume to the last; NaN
                                   for an open surface
        edge_change_percent        mean over the edges of the change, up or down, against an even
                                   change of each from its first length to its last
    Source: Hormann and Greiner 2000; used so by Cao et al. 2024.
    """
    between, straight = _both_ways(path)
    own, other = (_measured(shapes, path.times, path.faces) for shapes in (between, straight))
    return own.join(other.drop(columns="t").add_prefix("straight_"))


def interpolation_tables(paths: Sequence[ShapePath]) -> dict[str, pd.DataFrame]:
    """interpolation: `interpolation_quality` of each path, by template_id and case_id, one below
    the other; interpolation_curve. No tables without paths."""
    if not paths:
        return {}
    tables = []
    for path in paths:
        table = interpolation_quality(path)
        table.insert(0, "template_id", path.template_id)
        table.insert(1, "case_id", path.case_id)
        tables.append(table)
    return {
        "interpolation": pd.concat(tables, ignore_index=True),
        "interpolation_curve": interpolation_curve(paths),
    }


def interpolation_curve(paths: Sequence[ShapePath], steps: int = 50) -> pd.DataFrame:
    """Share (0 … 1) of triangles whose distortion is at most the threshold, over all paths.

    Returns:
        threshold, 0 … LIMIT, of σ₁/σ₂ + σ₂/σ₁ − 2; share, along X(t, t), all stored times but the
        first, every path with the same weight; straight_share, along the straight lines.
    """
    thresholds = np.linspace(0, LIMIT, steps + 1)
    rows = []
    for path in paths:
        for shapes in _both_ways(path):
            each = [_distortions(shape, shapes[0], path.faces) for shape in shapes[1:]]
            found = np.sort(each, axis=None)
            # Rounding lifts what keeps its angles a little above 2.
            rows.append(np.searchsorted(found, 2 + thresholds + 1e-6, side="right") / len(found))
    shares = np.reshape(rows, (len(paths), 2, len(thresholds))).mean(axis=0)
    return pd.DataFrame({"threshold": thresholds, "share": shares[0], "straight_share": shares[1]})


def _both_ways(path: ShapePath) -> tuple[np.ndarray, np.ndarray]:
    """(T, V, 3) X(t, t), and the straight line between its ends, at the stored times."""
    t = path.times[:, None, None]
    between = path.pose + t * path.offsets
    return between, (1 - t) * between[0] + t * between[-1]


def _measured(shapes: np.ndarray, times: np.ndarray, faces: np.ndarray) -> pd.DataFrame:
    is_closed = not len(boundary_edges(faces))
    volumes = np.array([volume(shape, faces) if is_closed else np.nan for shape in shapes])
    a, b = edges(faces).T
    lengths = np.linalg.norm(shapes[:, a] - shapes[:, b], axis=2)
    rows = []
    for shape, t, own_volume, own_lengths in zip(shapes, times, volumes, lengths, strict=True):
        distortion = _distortions(shape, shapes[0], faces)
        even_volume = (1 - t) * volumes[0] + t * volumes[-1]
        even_lengths = (1 - t) * lengths[0] + t * lengths[-1]
        rows.append(
            {
                "t": t,
                "conformal_distortion": distortion.mean(),
                "conformal_near_2_percent": 100 * (distortion <= 2 + NEAR).mean(),
                "volume_change_percent": 100 * (own_volume / even_volume - 1),
                "edge_change_percent": 100 * np.abs(own_lengths / even_lengths - 1).mean(),
            }
        )
    return pd.DataFrame(rows)


def _distortions(shape: np.ndarray, rest: np.ndarray, faces: np.ndarray) -> np.ndarray:
    result: np.ndarray = np.minimum(conformal_distortion(rest, shape, faces), WORST)
    return result

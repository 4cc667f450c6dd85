"""The shape matching literature's protocol: every pair of a test set against its known truth.

Mean geodesic error ×100 over √area, PCK curve and its area (Kim et al. 2011), as reported on
FAUST_r, SCAPE_r and SMAL_r. The matcher's own settings differ by benchmark (near-isometric shapes:
300 eigenfunctions and 384 features; non-isometric: 200 and 256) and belong to the workflows; this
module knows only a function that maps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ssm_pipeline.evaluation.matching_quality import area_under_curve, geodesic_errors, pck_curve
from ssm_pipeline.geometry.surface import area
from ssm_pipeline.records import CaseError, Mesh, StudyError

Predict = Callable[[Mesh, Mesh], np.ndarray]  # (x, y) → y_to_x (V_y,) int
Geodesics = Callable[[Mesh], np.ndarray]  # (V, V), the mesh's unit


@dataclass(frozen=True, eq=False)
class MatchingBenchmark:
    """summary  one row, comparable to a column of the papers' tables: benchmark, method, shapes,
             pairs, mean_geodesic_error_x100 (over √area), standard_error_x100 (over the pairs),
             auc (0 … 1).
    pairs    a row a pair: x, y, mean_geodesic_error_x100, median_geodesic_error_x100, auc.
    curve    threshold (over √area), share (0 … 1) of correct points, mean over the pairs."""

    summary: pd.DataFrame
    pairs: pd.DataFrame
    curve: pd.DataFrame


def run_matching_benchmark(
    meshes: Sequence[Mesh],
    template_to_shape: Sequence[np.ndarray],
    predict: Predict,
    geodesics: Geodesics,
    benchmark: str,
    method: str,
    with_self_pairs: bool = False,
    on_pair: Callable[[int, int], None] | None = None,
) -> MatchingBenchmark:
    """Match all ordered pairs (x, y) of the meshes and measure the errors on x.

    template_to_shape  per mesh (R,) int from 0: its vertex for each template vertex.
    predict            (x, y) → y_to_x (V_y,): for each vertex of y the matching vertex of x.
    geodesics          the distances of one mesh; asked once a mesh, so a cache isn't needed.
    with_self_pairs    count a shape's map to itself too. Public code of this line of work
                       (URSSM and after) does, which flatters: 1 pair in 20 for 20 shapes.
    on_pair            called with how many pairs are done, and of how many.

    The error of template vertex r is the geodesic on x between y_to_x[vts_y[r]] and vts_x[r].
    Raises StudyError for fewer than two shapes or templates of different length, CaseError for a
    map that isn't one vertex of x a vertex of y, or a mesh in several pieces.
    """
    _check(meshes, template_to_shape)
    names = [mesh.case_id for mesh in meshes]
    count = len(meshes)
    total = count * (count if with_self_pairs else count - 1)
    rows, curves = [], []
    for x, y, distances in _pairs(meshes, geodesics, with_self_pairs):
        y_to_x = _checked_map(predict(meshes[x], meshes[y]), meshes[x], meshes[y])
        errors = geodesic_errors(
            y_to_x[template_to_shape[y]],
            template_to_shape[x],
            distances,
            area(meshes[x].vertices, meshes[x].faces),
        )
        if not np.isfinite(errors).all():
            raise CaseError(
                names[x],
                f"the map from {names[y]} sends a point to another piece of the surface, which no "
                "path reaches. Leave the shape out, or connect its pieces.",
            )
        rows.append(
            {
                "x": names[x],
                "y": names[y],
                "mean_geodesic_error_x100": 100 * errors.mean(),
                "median_geodesic_error_x100": 100 * float(np.median(errors)),
                "auc": area_under_curve(errors),
            }
        )
        curves.append(pck_curve(errors))
        if on_pair:
            on_pair(len(rows), total)
    pairs = pd.DataFrame(rows)
    means = pairs["mean_geodesic_error_x100"]
    summary = pd.DataFrame(
        [
            {
                "benchmark": benchmark,
                "method": method,
                "shapes": count,
                "pairs": total,
                "mean_geodesic_error_x100": means.mean(),
                "standard_error_x100": means.std(ddof=1) / np.sqrt(total),
                "auc": pairs["auc"].mean(),
            }
        ]
    )
    # Every pair has as many points, so the mean of the curves is the curve of all points.
    curve = curves[0].assign(share=np.mean([one["share"] for one in curves], axis=0))
    return MatchingBenchmark(summary, pairs, curve)


def _pairs(
    meshes: Sequence[Mesh], geodesics: Geodesics, with_self_pairs: bool
) -> Iterator[tuple[int, int, np.ndarray]]:
    """Ordered pairs with the distances on x; one matrix at a time is held."""
    for x in range(len(meshes)):
        distances = geodesics(meshes[x])
        for y in range(len(meshes)):
            if x != y or with_self_pairs:
                yield x, y, distances


def _check(meshes: Sequence[Mesh], template_to_shape: Sequence[np.ndarray]) -> None:
    if len(meshes) < 2:
        raise StudyError(f"a matching benchmark needs at least 2 shapes; {len(meshes)} given.")
    for mesh, vertices in zip(meshes, template_to_shape, strict=True):
        if len(vertices) != len(template_to_shape[0]):
            raise StudyError(
                f"{mesh.case_id} has correspondences for {len(vertices)} template vertices, "
                f"{meshes[0].case_id} for {len(template_to_shape[0])}; all shapes of a set need "
                "the same template. Run its categories one by one."
            )


def _checked_map(y_to_x: np.ndarray, x: Mesh, y: Mesh) -> np.ndarray:
    y_to_x = np.asarray(y_to_x)
    if y_to_x.shape != (len(y.vertices),) or not np.issubdtype(y_to_x.dtype, np.integer):
        raise CaseError(
            y.case_id,
            f"the map to {x.case_id} is {y_to_x.dtype} of shape {y_to_x.shape}; one integer a "
            f"vertex, ({len(y.vertices)},), is needed.",
        )
    if y_to_x.min() < 0 or y_to_x.max() >= len(x.vertices):
        raise CaseError(
            y.case_id,
            f"the map to {x.case_id} names vertices {y_to_x.min()} to {y_to_x.max()}; "
            f"0 to {len(x.vertices) - 1} exist.",
        )
    return y_to_x

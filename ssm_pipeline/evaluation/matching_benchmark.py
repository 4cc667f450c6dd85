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
from ssm_pipeline.records import CaseError, KnownPair, Mesh, StudyError

Predict = Callable[[Mesh, Mesh], np.ndarray]  # (x, y) → y_to_x (V_y,) int
Geodesics = Callable[[Mesh], np.ndarray]  # (V, V), the mesh's unit


@dataclass(frozen=True, eq=False)
class MatchingBenchmark:
    """Tables of a matching benchmark.

    Attributes:
        summary: One row, comparable to a column of the papers' tables: benchmark, method, shapes,
            pairs, mean_geodesic_error_x100 (over √area), standard_error_x100 (over the pairs),
            pck_005_percent (of the points, with an error of at most 0.05 √area), auc (0 … 1).
        pairs: A row per pair: method, x, y, mean_geodesic_error_x100, median_geodesic_error_x100,
            auc.
        curve: method, threshold (over √area), share (0 … 1) of correct points, mean over the pairs.
    """

    summary: pd.DataFrame
    pairs: pd.DataFrame
    curve: pd.DataFrame


def run_matching_benchmark(
    meshes: Sequence[Mesh],
    known: Sequence[KnownPair],
    predict: Predict,
    geodesics: Geodesics,
    benchmark: str,
    method: str,
    on_pair: Callable[[int, int], None] | None = None,
) -> MatchingBenchmark:
    """Match the pairs (x, y) of the meshes whose truth is known and measure the errors on x.

    The error of a known point is the geodesic on x between y_to_x[on_y] and on_x.

    Args:
        known: The pairs. Public code of this line of work (URSSM and after) counts a shape's map to
            itself too, which flatters: 1 pair in 20 for 20 shapes.
        predict: (x, y) → y_to_x (V_y,): for each vertex of y the matching vertex of x.
        geodesics: The distances of one mesh; asked once a mesh if the pairs are in the order of x,
            so a cache isn't needed.
        on_pair: Called with how many pairs are done, and of how many.

    Raises:
        StudyError: Without pairs.
        CaseError: For a map that isn't one vertex of x a vertex of y, or where no path joins the
            match to the truth.
    """
    if not known:
        raise StudyError(
            "there is no pair of test shapes whose correspondence is known; a matching benchmark "
            "needs one at least. Choose other test shapes."
        )
    rows, curves = [], []
    for pair, distances in _with_distances(meshes, known, geodesics):
        x, y = meshes[pair.x], meshes[pair.y]
        y_to_x = _checked_map(predict(x, y), x, y)
        errors = geodesic_errors(y_to_x[pair.on_y], pair.on_x, distances, area(x.vertices, x.faces))
        if not np.isfinite(errors).all():
            raise CaseError(
                x.case_id,
                f"the map from {y.case_id} sends a point to another piece of the surface, which "
                "no path reaches. Leave the shape out, or connect its pieces.",
            )
        rows.append(
            {
                "method": method,
                "x": x.case_id,
                "y": y.case_id,
                "mean_geodesic_error_x100": 100 * errors.mean(),
                "median_geodesic_error_x100": 100 * float(np.median(errors)),
                "pck_005_percent": 100 * float((errors <= 0.05).mean()),
                "auc": area_under_curve(errors),
            }
        )
        curves.append(pck_curve(errors))
        if on_pair:
            on_pair(len(rows), len(known))
    pairs = pd.DataFrame(rows)
    means = pairs["mean_geodesic_error_x100"]
    summary = pd.DataFrame(
        [
            {
                "benchmark": benchmark,
                "method": method,
                "shapes": len({shape for pair in known for shape in (pair.x, pair.y)}),
                "pairs": len(known),
                "mean_geodesic_error_x100": means.mean(),
                "standard_error_x100": means.std(ddof=1) / np.sqrt(len(known)),
                "pck_005_percent": pairs["pck_005_percent"].mean(),
                "auc": pairs["auc"].mean(),
            }
        ]
    )
    # Every pair counts alike, however many of its points are known.
    share = np.mean([one["share"] for one in curves], axis=0)
    curve = curves[0].assign(share=share)
    curve.insert(0, "method", method)
    return MatchingBenchmark(summary, pairs, curve)


def _with_distances(
    meshes: Sequence[Mesh], known: Sequence[KnownPair], geodesics: Geodesics
) -> Iterator[tuple[KnownPair, np.ndarray]]:
    """The pairs with the distances on x; one matrix at a time is held."""
    x, distances = -1, np.empty(0)
    for pair in known:
        if pair.x != x:
            x, distances = pair.x, geodesics(meshes[pair.x])
        yield pair, distances


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

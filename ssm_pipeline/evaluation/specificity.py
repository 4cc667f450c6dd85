"""Specificity: how near the shapes a model invents are to shapes that exist.

Every draw should be compared with every training mesh, both ways: 3.7·10⁹ nearest-neighbour
queries for 1000 draws, 22 meshes, 21 numbers of modes and 4000 points. Here a subset of the points
ranks the meshes first, and only those that may be the nearest are compared in full.

Source: Davies 2002; Styner et al. 2003.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ssm_pipeline.evaluation.sampling import FixedPoints, spatial_order
from ssm_pipeline.evaluation.settings import EvaluationSettings, mode_counts
from ssm_pipeline.geometry.distances import PointTarget, SurfaceTarget, chamfer
from ssm_pipeline.geometry.surface import sample_points
from ssm_pipeline.records import Mesh
from ssm_pipeline.shape_model.model import ShapeModel


def specificity(
    model: ShapeModel,
    meshes: Sequence[Mesh],
    settings: EvaluationSettings,
    generator: np.random.Generator,
) -> pd.DataFrame:
    """S(M): mean distance of the model's draws to the nearest training mesh.

    The draws for M modes are those for all modes, cut off after M (common random numbers): the
    curve over M is smooth, and its differences are far surer than its values.

    meshes   the training meshes, in the model's frame (`model_quality.move_meshes`).
    Returns  one row per M: modes, chamfer_mm, chamfer_se_mm, samples; surface_mm, surface_se_mm,
             hd95_mm, hd95_se_mm, surface_samples (NaN and 0 for a model without faces);
             chamfer_floor_mm, the mean Chamfer of two samplings of one training mesh; points.
             Standard errors are over the draws.
    """
    points = FixedPoints.of(model.mean, model.faces, settings.points, generator)
    targets, again = (
        [PointTarget.of(_even_samples(mesh, points.count, generator)) for mesh in meshes]
        for _ in range(2)
    )
    floor = float(np.mean([chamfer(a, b) for a, b in zip(targets, again, strict=True)]))
    surfaces = [SurfaceTarget.of(mesh.vertices, mesh.faces) for mesh in meshes]
    scores = generator.standard_normal((settings.samples, model.mode_count))

    fields = (points.on(model.modes) * model.standard_deviations[:, None, None]).astype(np.float32)
    draws = np.repeat(points.on(model.mean)[None].astype(np.float32), settings.samples, axis=0)
    wanted, done, rows = mode_counts(model.mode_count, settings.mode_counts), 0, []
    for modes in wanted:
        draws += np.tensordot(scores[:, done:modes].astype(np.float32), fields[done:modes], axes=1)
        done = modes
        nearest, ranked = nearest_chamfer(
            draws, targets, settings.screening_points, settings.screening_errors
        )
        row: dict[str, float] = {"modes": modes, "samples": len(nearest)}
        row |= _mean_and_error("chamfer", nearest)
        surface = _nearest_surface(
            model, scores[: settings.surface_samples, :modes], surfaces, ranked, settings
        )
        row |= _mean_and_error("surface", surface[:, 0]) | _mean_and_error("hd95", surface[:, 1])
        rows.append(row | {"surface_samples": len(surface)})
    return pd.DataFrame(rows).assign(chamfer_floor_mm=floor, points=points.count)


def nearest_chamfer(
    draws: np.ndarray,
    targets: Sequence[PointTarget],
    screening_points: int,
    screening_errors: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Chamfer distance of each draw to the nearest target, and the targets' order by estimate.

    draws (n, P, 3) float32, points and targets in spatial order. Every distance is first
    estimated from `screening_points` of the points, both ways. In the order of the estimates the
    targets are then compared in full, but for those whose estimate less `screening_errors` of its
    standard errors is above the best distance found. Points in spatial order make the subset
    even, and its true error about 0.3 of that standard error (which is as of free draws), so that
    2 of them are nearly 7 of the true: the nearest target is missed practically never (tests,
    benchmarks/bench_evaluation.py).

    Returns (n,) distances and (n, T) target indices, nearest first by the estimate.
    """
    count, size = len(draws), draws.shape[1]
    subset = np.linspace(0, size - 1, min(screening_points, size)).round().astype(int)
    asked = np.concatenate([target.points[subset] for target in targets])
    thin = np.ascontiguousarray(draws[:, subset]).reshape(-1, 3)
    to_target = np.stack([target.distances_to(thin) for target in targets])
    to_target = to_target.reshape(len(targets), count, len(subset))

    nearest = np.empty(count)
    ranked = np.empty((count, len(targets)), dtype=np.int64)
    for index, points in enumerate(draws):
        draw = PointTarget.of(points)
        to_draw = draw.distances_to(asked).reshape(len(targets), len(subset))
        out = to_target[:, index]
        estimate = 0.5 * (out.mean(axis=1) + to_draw.mean(axis=1))
        error = 0.5 * np.sqrt((out.var(axis=1) + to_draw.var(axis=1)) / len(subset))
        ranked[index] = order = estimate.argsort()
        bound = estimate - screening_errors * error
        best = np.inf
        for target in order:
            if bound[target] <= best:
                best = min(best, chamfer(draw, targets[target]))
        nearest[index] = best
    return nearest, ranked


def _nearest_surface(
    model: ShapeModel,
    scores: np.ndarray,
    surfaces: Sequence[SurfaceTarget],
    ranked: np.ndarray,
    settings: EvaluationSettings,
) -> np.ndarray:
    """(n, 2) symmetric mean and HD95 to the nearest of the two meshes nearest by Chamfer.

    From an even subset of either's vertices to the other's triangles.
    """
    if not len(model.faces):
        return np.empty((0, 2))
    result = np.empty((len(scores), 2))
    for index, vertices in enumerate(model.reconstruct(scores)):
        draw = SurfaceTarget.of(vertices, model.faces)
        found = []
        for target in ranked[index, :2]:
            surface = surfaces[target]
            out = surface.distances_to(_thinned(vertices, settings.surface_points))
            back = draw.distances_to(_thinned(surface.vertices, settings.surface_points))
            found.append(
                (
                    0.5 * (out.mean() + back.mean()),
                    max(np.percentile(out, 95), np.percentile(back, 95)),
                )
            )
        result[index] = np.min(found, axis=0)
    return result


def _even_samples(mesh: Mesh, count: int, generator: np.random.Generator) -> np.ndarray:
    samples = sample_points(mesh.vertices, mesh.faces, count, generator)
    return samples[spatial_order(samples)]


def _thinned(points: np.ndarray, count: int) -> np.ndarray:
    step = max(1, len(points) // count)
    return points[::step]


def _mean_and_error(name: str, values: np.ndarray) -> dict[str, float]:
    """Mean and standard error over independent draws, in mm."""
    if not len(values):
        return {f"{name}_mm": np.nan, f"{name}_se_mm": np.nan}
    error = values.std(ddof=1) / np.sqrt(len(values))
    return {f"{name}_mm": float(values.mean()), f"{name}_se_mm": float(error)}

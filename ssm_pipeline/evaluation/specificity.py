"""Specificity: how near the shapes a model invents are to shapes that exist.

Every draw should be compared with every training mesh, both ways: 3.7·10⁹ nearest-neighbour
queries for 1000 draws, 22 meshes, 21 numbers of modes and 4000 points. Here a subset of the points
ranks the meshes first, and only those that may be the nearest are compared in full.

Source: Davies 2002; Styner et al. 2003.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import joblib
import numpy as np
import pandas as pd

from ssm_pipeline.evaluation.sampling import FixedPoints, spatial_order
from ssm_pipeline.evaluation.settings import EvaluationSettings, mode_counts
from ssm_pipeline.geometry.distances import PointTarget, SurfaceTarget, chamfer, symmetric
from ssm_pipeline.geometry.surface import sample_points
from ssm_pipeline.parallel import in_processes
from ssm_pipeline.records import Mesh
from ssm_pipeline.shape_model.model import ShapeModel

DRAWS_AT_ONCE = 100  # 16 000 points of each and a tree of them: 40 MB


def specificity(
    model: ShapeModel,
    meshes: Sequence[Mesh],
    settings: EvaluationSettings,
    generator: np.random.Generator,
    jobs: int = 1,
    modes: Sequence[int] | None = None,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """S(M): mean distance of the model's draws to the nearest training mesh.

    The draws for M modes are those for all modes, cut off after M (common random numbers): the
    curve over M is smooth, and its differences are far surer than its values. They are made of
    random weights of the cases (`drawn_scores`), so those of another method pair with them.

    Args:
        meshes: The training meshes, in the model's frame (`aligned_cohort.move_meshes`).
        modes: The numbers of modes; by default 1 … all, or `settings.mode_counts` of them.
        jobs: Processes, one number of modes each at a time; the result does not depend on it.

    Returns:
        One row per M: modes, chamfer_mm, chamfer_se_mm, samples; surface_mm, surface_se_mm,
        hd95_mm, hd95_se_mm, surface_samples; chamfer_floor_mm, the mean Chamfer of two samplings of
        one training mesh; points. Standard errors are over the draws. And one row per M and draw
        that was scored vertex to triangle: modes, draw, surface_mm.
    """
    points = FixedPoints.of(model.mean, model.faces, settings.points, generator)
    samples, again = (
        [even_samples(mesh, points.count, generator) for mesh in meshes] for _ in range(2)
    )
    floor = np.mean(
        [chamfer(*map(PointTarget.of, pair)) for pair in zip(samples, again, strict=True)]
    )
    weights = generator.standard_normal((settings.samples, len(model.case_ids)))
    scores = drawn_scores(model, weights)
    if modes is None:
        modes = mode_counts(model.mode_count, settings.mode_counts)
    tasks = [
        joblib.delayed(_row)(model.truncate(M), scores[:, :M], points, samples, meshes, settings)
        for M in modes
    ]
    rows, draws = zip(*in_processes(tasks, jobs), strict=True)
    table = pd.DataFrame(list(rows)).assign(chamfer_floor_mm=floor, points=points.count)
    return table, pd.concat(draws, ignore_index=True)


def drawn_scores(model: ShapeModel, weights: np.ndarray) -> np.ndarray:
    """Scores (n, M) of draws from the model's normal distribution, in standard deviations.

    weights (n, N), independent standard normal: draw = mean + Σ_i w_i (x_i − mean) / √(N − 1),
    which has the model's covariance exactly. Two models of the same cases then draw alike: of one
    and the same correspondence the same shapes, whatever the order and signs of their modes.
    """
    result: np.ndarray = weights @ model.scores / np.sqrt(len(model.case_ids) - 1)
    return result


def _row(
    model: ShapeModel,
    scores: np.ndarray,
    points: FixedPoints,
    samples: Sequence[np.ndarray],
    meshes: Sequence[Mesh],
    settings: EvaluationSettings,
) -> tuple[dict[str, float], pd.DataFrame]:
    """One number of modes: the model cut off there, and as many scores (n, M) of each draw."""
    fields = (points.on(model.modes) * model.standard_deviations[:, None, None]).astype(np.float32)
    draws = np.tensordot(scores.astype(np.float32), fields, axes=1)
    draws += points.on(model.mean).astype(np.float32)
    nearest, left = nearest_chamfer(
        draws,
        [PointTarget.of(sample) for sample in samples],
        settings.screening_points,
        settings.screening_errors,
        settings.asked_points,
    )
    surfaces = [SurfaceTarget.of(mesh.vertices, mesh.faces) for mesh in meshes]
    shapes = model.reconstruct(scores[: settings.surface_samples])
    candidates = [kept[:2] for kept in left]
    surface = nearest_surface(shapes, model.faces, surfaces, candidates, settings.surface_points)
    row = (
        {"modes": model.mode_count}
        | _mean_and_error("chamfer", nearest)
        | {"samples": len(nearest)}
        | _mean_and_error("surface", surface[:, 0])
        | _mean_and_error("hd95", surface[:, 1])
        | {"surface_samples": len(surface)}
    )
    per_draw = {"modes": model.mode_count, "draw": range(len(surface)), "surface_mm": surface[:, 0]}
    return row, pd.DataFrame(per_draw)


def nearest_chamfer(
    draws: np.ndarray,
    targets: Sequence[PointTarget],
    screening_points: int,
    screening_errors: float,
    asked_points: int | None = None,
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Chamfer distance of each draw to the nearest target, and the targets that were in question.

    draws (n, P, 3) float32, points and targets in spatial order. Every distance is first estimated
    from a quarter of `screening_points`, then from all of them, both ways; a target is out where
    its estimate, less `screening_errors` of its standard errors, is above the best estimate plus as
    many of that one's. What is left is compared by `asked_points` of the points (None: all) against
    all of the other shape's, nearest first, with the same bound. Points in spatial order make a
    subset even, and its true error about 0.3 of the standard error (which is as of free draws), so
    that 2 of them are nearly 7 of the true: the nearest target is missed practically never (tests,
    benchmarks/bench_evaluation.py).

    Returns:
        (n,) distances and, per draw, the indices of the targets left by `screening_points`, nearest
        first.
    """
    size = draws.shape[1]
    subsets = [
        even_subset(size, count)
        for count in (screening_points // 4, screening_points, asked_points or size)
    ]
    nearest, left = np.empty(len(draws)), []
    for first in range(0, len(draws), DRAWS_AT_ONCE):
        block = slice(first, first + DRAWS_AT_ONCE)
        nearest[block], kept = _nearest_in_block(draws[block], targets, subsets, screening_errors)
        left += kept
    return nearest, left


def _nearest_in_block(
    draws: np.ndarray,
    targets: Sequence[PointTarget],
    subsets: Sequence[np.ndarray],
    screening_errors: float,
) -> tuple[np.ndarray, list[np.ndarray]]:
    """`nearest_chamfer` of a few draws, whose k-d trees are held at once."""
    *screens, asked = subsets
    shapes = [PointTarget.of(points) for points in draws]
    draw, target = np.divmod(np.arange(len(shapes) * len(targets)), len(targets))
    for subset in screens:
        estimate, error = pair_estimates(shapes, targets, draw, target, subset)
        order = np.lexsort((estimate, draw))  # draw by draw, the nearest first
        draw, target, estimate = draw[order], target[order], estimate[order]
        margin = screening_errors * error[order]
        bound = estimate - margin
        possible = bound <= (estimate + margin)[_starts(draw)][draw]
        draw, target, bound = draw[possible], target[possible], bound[possible]
    starts = _starts(draw)
    rank = np.arange(len(draw)) - starts[draw]
    nearest = np.full(len(shapes), np.inf)
    for place in range(rank.max() + 1):
        asked_for = (rank == place) & (bound <= nearest[draw])
        of = draw[asked_for]
        distance, _ = pair_estimates(shapes, targets, of, target[asked_for], asked)
        nearest[of] = np.minimum(nearest[of], distance)
    return nearest, np.split(target, starts[1:])


def _starts(draw: np.ndarray) -> np.ndarray:
    """(n,) where each draw's pairs begin; of pairs (K,) in the order of the draws, all present."""
    return np.flatnonzero(np.diff(draw, prepend=-1))


def pair_estimates(
    draws: Sequence[PointTarget],
    targets: Sequence[PointTarget],
    draw: np.ndarray,
    target: np.ndarray,
    subset: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Of pairs draw (K,) and target (K,), (K,) Chamfer distances from a subset of the points, and
    their standard errors."""
    out, back = (np.empty((len(draw), len(subset)), dtype=np.float32) for _ in range(2))
    # All that is asked of a tree is asked at once: a tree that was not asked for a while is cold.
    for number in np.unique(target):
        pairs = np.flatnonzero(target == number)
        asked = np.concatenate([draws[n].points[subset] for n in draw[pairs]])
        out[pairs] = targets[number].distances_to(asked).reshape(len(pairs), -1)
    for number in np.unique(draw):
        pairs = np.flatnonzero(draw == number)
        asked = np.concatenate([targets[n].points[subset] for n in target[pairs]])
        back[pairs] = draws[number].distances_to(asked).reshape(len(pairs), -1)
    estimate = 0.5 * (out.mean(axis=1) + back.mean(axis=1))
    return estimate, 0.5 * np.sqrt((out.var(axis=1) + back.var(axis=1)) / len(subset))


def estimates(
    draw: PointTarget, targets: Sequence[PointTarget], subset: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """`pair_estimates` of one draw and every target (T,)."""
    every = np.arange(len(targets))
    return pair_estimates([draw], targets, np.zeros_like(every), every, subset)


def even_subset(size: int, count: int) -> np.ndarray:
    """`count` of the numbers 0 … size − 1, evenly; all where there are no more."""
    return np.linspace(0, size - 1, min(count, size)).round().astype(np.int64)


def nearest_surface(
    shapes: np.ndarray,
    faces: np.ndarray,
    surfaces: Sequence[SurfaceTarget] | Mapping[int, SurfaceTarget],
    candidates: Sequence[np.ndarray],
    count: int,
) -> np.ndarray:
    """Distances of each shape to the nearest of its candidates.

    Args:
        shapes: (n, V, 3).
        candidates: Per shape, places in `surfaces`.
        count: About so many vertices of either shape are compared with the other's triangles.

    Returns:
        (n, 2) symmetric mean and HD95, both to the candidate with the smallest mean.
    """
    result = np.empty((len(shapes), 2))
    for index, vertices in enumerate(shapes):
        draw = SurfaceTarget.of(vertices, faces)
        found = []
        for target in candidates[index]:
            surface = surfaces[target]
            out = surface.distances_to(_thinned(vertices, count))
            back = draw.distances_to(_thinned(surface.vertices, count))
            distance = symmetric(out, back)
            found.append((distance.mean, distance.hd95))
        result[index] = min(found)  # by the mean: both distances are of one mesh
    return result


def even_samples(mesh: Mesh, count: int, generator: np.random.Generator) -> np.ndarray:
    samples = sample_points(mesh.vertices, mesh.faces, count, generator)
    result: np.ndarray = samples[spatial_order(samples)]
    return result


def _thinned(points: np.ndarray, count: int) -> np.ndarray:
    step = max(1, len(points) // count)
    return points[::step]


def _mean_and_error(name: str, values: np.ndarray) -> dict[str, float]:
    """Mean and standard error over independent draws, in mm."""
    error = values.std(ddof=1) / np.sqrt(len(values))
    return {f"{name}_mm": float(values.mean()), f"{name}_se_mm": float(error)}

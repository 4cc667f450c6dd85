"""Scores of corresponded shapes of any method, or of a model of them, as in a study's tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from ssm_pipeline.evaluation.comparison import compare
from ssm_pipeline.evaluation.evaluate import Scoring, evaluate_method
from ssm_pipeline.evaluation.settings import EvaluationSettings
from ssm_pipeline.evaluation.tables import with_surface_fits
from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.records import (
    CorrespondedShapes,
    Mesh,
    Metrics,
    StudyError,
    require_each,
    require_type,
)
from ssm_pipeline.shape_model.model import ShapeModel

FARTHEST_SHARE = 0.25  # of a shape's size: its vertices lie nearer to its own mesh than this


def evaluate(
    shapes: CorrespondedShapes | ShapeModel,
    meshes: Sequence[Mesh],
    settings: EvaluationSettings | None = None,
    seed: int = 0,
    name: str = "own method",
    with_scale: bool = False,
    jobs: int = 1,
) -> Metrics:
    """Compactness, generalisation, specificity and fit, as a study's tables give them.

    Args:
        shapes: N >= 4 corresponded shapes of any method; or a model with all its modes and scores,
            from which the cases are rebuilt.
        meshes: The surface of each case, in the same place as its shape: in the case's own
            millimetres for shapes as matched, in the model's frame for a model. In any order, by
            case_id.
        settings: Numbers of points and draws. None: a study's defaults.
        seed: Decides the points and draws.
        name: The value of the column `method`.
        with_scale: Whether the alignment removes size.
        jobs: The number of processes.

    Returns:
        `.tables` by name: compactness, generalisation (a row per case), generalisation_mean,
        specificity, correspondence; lengths in mm.

    Raises:
        TypeError: For arguments of other types.
        StudyError: For too few cases, a model without its cases, or meshes that lie elsewhere than
            the shapes.

    Source: Davies et al. 2002, "A minimum description length approach to statistical shape
    modeling" (compactness, generalisation, specificity).

    Examples:
        >>> import trimesh
        >>> ball = trimesh.creation.icosphere(2)
        >>> sizes = np.array([[30, 40, 50], [33, 39, 55], [28, 41, 47], [31, 44, 52]])
        >>> ids = ("a", "b", "c", "d")
        >>> shapes = CorrespondedShapes(sizes[:, None] * ball.vertices, ball.faces, ids, "a")
        >>> meshes = [Mesh(v, ball.faces, i) for v, i in zip(shapes.vertices, ids)]
        >>> quick = EvaluationSettings(points=200, samples=10, surface_samples=2)
        >>> tables = evaluate(shapes, meshes, quick).tables
        >>> tables["generalisation_mean"]["modes"].tolist()
        [1, 2]
    """
    require_type(shapes, (CorrespondedShapes, ShapeModel), "shapes")
    require_each(meshes, Mesh, "meshes", "Read a file with read_mesh.")
    if isinstance(shapes, ShapeModel):
        shapes = cases_of(shapes)
    _check_places(shapes, meshes)
    scoring = Scoring(settings or EvaluationSettings(), seed, with_scale, jobs)
    return evaluate_method(name, shapes, meshes, scoring)


def compare_methods(
    scored: Mapping[str, Metrics], baseline: str, draws: int = 10_000, seed: int = 0
) -> pd.DataFrame:
    """Compare methods on the same cases, each with one of them as the baseline.

    Args:
        scored: What `evaluate` returned for each method, by name: of the same cases, with the same
            settings and seed.
        baseline: The name of the method that the others are compared with.
        draws: The number of resamplings of the cases.
        seed: Decides the resamplings.

    Returns:
        A row per method, as in a study's comparison.csv: method, modes (the same number for all),
        variance_percent, variance_mm2, cases, points; generalisation and specificity, each with its
        standard error, by surface distance, Chamfer distance and HD95; surface_fit_mm; and for
        generalisation (surface, Chamfer) and specificity (surface) the difference to the baseline,
        _low_mm and _high_mm of its 95 % interval over the cases, and _p, by Holm's correction. The
        interval of specificity needs `EvaluationSettings(jackknife_samples=24)` or so, else it is
        NaN. Lengths in mm.

    Raises:
        ValueError: For methods that were not scored alike, or an unknown baseline.

    Examples:
        >>> import trimesh
        >>> ball = trimesh.creation.icosphere(2)
        >>> sizes = np.array([[30, 40, 50], [33, 39, 55], [28, 41, 47], [31, 44, 52]])
        >>> ids = ("a", "b", "c", "d")
        >>> right = CorrespondedShapes(sizes[:, None] * ball.vertices, ball.faces, ids, "a")
        >>> meshes = [Mesh(v, ball.faces, i) for v, i in zip(right.vertices, ids)]
        >>> slid = right.vertices.copy()
        >>> slid[1] = sizes[1] * ball.vertices[:, [1, 2, 0]]  # on the same surface, other vertices
        >>> wrong = CorrespondedShapes(slid, ball.faces, ids, "a")
        >>> quick = EvaluationSettings(points=200, samples=10, surface_samples=2)
        >>> scored = {
        ...     "right": evaluate(right, meshes, quick), "wrong": evaluate(wrong, meshes, quick)
        ... }
        >>> table = compare_methods(scored, "right", draws=100).set_index("method")
        >>> bool(table.loc["wrong", "generalisation_surface_difference_mm"] > 0)
        True
    """
    table = compare(scored, baseline, draws, np.random.default_rng(seed))
    return with_surface_fits(table, scored)


def cases_of(model: ShapeModel) -> CorrespondedShapes:
    """The cases that a model was built from, in its frame.

    Raises:
        StudyError: For a model without its cases, or without all their modes.
    """
    count = len(model.case_ids)
    if not count:
        raise StudyError(
            "the model names no cases, so leaving one out is impossible. Pass the corresponded "
            "shapes it was built from."
        )
    rebuilt = model.reconstruct(model.scores)
    # Cases rebuilt from fewer modes would lack what the model lacks, and give too good scores.
    if model.mode_count < count - 1:
        raise StudyError(
            f"the model holds {model.mode_count} modes of {count} cases; {count - 1} are needed to "
            "rebuild the cases. Pass the corresponded shapes it was built from."
        )
    return CorrespondedShapes(rebuilt, model.faces, model.case_ids, model.case_ids[0])


def _check_places(shapes: CorrespondedShapes, meshes: Sequence[Mesh]) -> None:
    by_id = {mesh.case_id: mesh for mesh in meshes}
    for case_id, points in zip(shapes.case_ids, shapes.vertices, strict=True):
        if case_id not in by_id:
            raise StudyError(
                f"case {case_id} has no mesh among {len(meshes)}; one with that case_id is needed."
            )
        mesh = by_id[case_id]
        distance = float(closest_points(points, mesh.vertices, mesh.faces).distances.mean())
        size = float(np.linalg.norm(np.ptp(points, axis=0)))
        if distance > FARTHEST_SHARE * size:
            raise StudyError(
                f"the shape of case {case_id} lies {distance:.1f} mm from its mesh; both must lie "
                "in the same place. Give meshes in the case's own millimetres with shapes as "
                "matched, in the model's frame with a model."
            )

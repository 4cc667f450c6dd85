"""One's own method in our tables: corresponded shapes, or a model of them, scored."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssm_pipeline.evaluation.evaluate import Scoring, evaluate_method
from ssm_pipeline.evaluation.settings import EvaluationSettings
from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.records import CorrespondedShapes, Mesh, Metrics, StudyError
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

    shapes      N >= 4 corresponded shapes of any method; or a model with all its modes and scores,
                whose cases are then rebuilt from it.
    meshes      each case's own surface, lying where its shape lies: in the case's own millimetres
                for shapes as matched, in the model's frame for a model. In any order, by case_id.
    settings    numbers of points and draws; None: as a study's.
    seed        of points and draws. name: what the column `method` says.
    with_scale  whether the alignment removes size. jobs: processes.
    Returns     `.tables` by name: compactness, generalisation (a row per case),
                generalisation_mean, specificity, correspondence; millimetres.
    Raises      StudyError for too few cases, a model without its cases, or meshes that lie
                elsewhere than the shapes.

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
    if isinstance(shapes, ShapeModel):
        shapes = cases_of(shapes)
    _check_places(shapes, meshes)
    scoring = Scoring(settings or EvaluationSettings(), seed, with_scale, jobs)
    return evaluate_method(name, shapes, meshes, scoring)


def cases_of(model: ShapeModel) -> CorrespondedShapes:
    """The cases that a model was built of, in its frame. Raises StudyError if it can't say."""
    count = len(model.case_ids)
    if not count:
        raise StudyError(
            "the model names no cases, so leaving one out is impossible. Pass the corresponded "
            "shapes it was built of."
        )
    rebuilt = model.reconstruct(model.scores)
    # All modes are kept if and only if the scores' own variance is all there is; a model of fewer
    # modes would flatter itself, since what they lack is lacking in its cases too.
    if model.mode_count < count - 1:
        raise StudyError(
            f"the model holds {model.mode_count} modes of {count} cases; {count - 1} are needed to "
            "rebuild the cases. Pass the corresponded shapes it was built of."
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

"""What a new surface is compared with: the model's own cases, or shapes drawn from the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ssm_pipeline.fitting.cross_validation import CrossValidation, can_judge
from ssm_pipeline.records import CorrespondedShapes, Mesh
from ssm_pipeline.shape_model.model import ShapeModel

DRAWN_CASES = 20


@dataclass(frozen=True, eq=False)
class Yardstick:
    """What a new surface is compared with.

    Attributes:
        model: The shape model of the cases.
        shapes: The model's cases as matched.
        meshes: The surfaces of the cases, in the same order.
        reference: `cross_validate` of both.
        with_scale: Whether the alignment of the cases removed size.
        patients: `(N,)` the patient of each case. None: every case is a patient of its own.
    """

    model: ShapeModel
    shapes: CorrespondedShapes
    meshes: Sequence[Mesh]
    reference: CrossValidation
    with_scale: bool = False
    patients: Sequence[str] | None = None


def rebuilt_cases(model: ShapeModel) -> CorrespondedShapes | None:
    """The cases that a model was built from, in the model's frame.

    Args:
        model: A model.

    Returns:
        The cases; None where the model does not hold all of them, or too few to judge by.
    """
    count = len(model.case_ids)
    if model.mode_count < count - 1 or count == 0 or not can_judge(model.case_ids):
        return None
    return CorrespondedShapes(
        model.reconstruct(model.scores), model.faces, model.case_ids, model.case_ids[0]
    )


def drawn_cases(model: ShapeModel, seed: int) -> CorrespondedShapes:
    """Shapes drawn from a model, in the place of its cases.

    They are more alike than patients, so thresholds and intervals come out too narrow.

    Args:
        model: A model.
        seed: Decides the draws.

    Returns:
        20 shapes or twice as many as the model has modes, in the model's frame.
    """
    count = max(DRAWN_CASES, 2 * model.mode_count)
    drawn = model.sample(count, np.random.default_rng(seed))
    ids = tuple(f"drawn_{index:03d}" for index in range(count))
    return CorrespondedShapes(drawn, model.faces, ids, ids[0])


def meshes_of(shapes: CorrespondedShapes) -> list[Mesh]:
    """Each shape as a mesh of its own."""
    return [
        Mesh(vertices, shapes.faces, case_id)
        for vertices, case_id in zip(shapes.vertices, shapes.case_ids, strict=True)
    ]

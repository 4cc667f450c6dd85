"""Generalisation as a clinician meets it: a new patient's surface, and no correspondence of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import joblib
import numpy as np
import pandas as pd

from ssm_pipeline.evaluation.aligned_cohort import AlignedCohort, moved
from ssm_pipeline.fitting.model_fit import fit_model
from ssm_pipeline.geometry.distances import SurfaceTarget, surface_distance
from ssm_pipeline.parallel import in_processes
from ssm_pipeline.records import Mesh
from ssm_pipeline.shape_model.model import ShapeModel

MOST_MODES = 100  # of a fit: its cost grows with them, and a surface tells no more


def fits_to_held_out(
    cohort: AlignedCohort, folds: Sequence[np.ndarray], modes: int, jobs: int = 1
) -> pd.DataFrame:
    """How well a model built without a case can be fitted to that case's surface.

    Unlike `generalisation`, no point of the held-out case's correspondence is used: the model finds
    its scores by itself (`fitting.model_fit`), and is held by its prior. It starts from the pose
    that the correspondence gives, and corrects it: where a patient lies unknown, `workflow fit`
    searches for the pose first, which is not scored here.

    Args:
        folds: The cases held out at a time (`held_out_folds`).
        modes: Of each model, at most as many as it has and MOST_MODES.

    Returns:
        One row per case: case_id, modes, surface_mm, hd95_mm (fitted instance and mesh, both ways).
    """

    def tasks() -> Iterator[Any]:  # one fold's model at a time: all of them are GB
        for held_out in folds:
            model, frames = cohort.without(held_out)
            model = model.truncate(min(modes, model.mode_count, MOST_MODES))
            for case, frame in zip(held_out, frames, strict=True):
                yield joblib.delayed(_fitted)(model, moved(cohort.meshes[case], frame))

    rows = in_processes(tasks(), jobs)
    order = {case_id: number for number, case_id in enumerate(cohort.shapes.case_ids)}
    return pd.DataFrame(sorted(rows, key=lambda row: order[str(row["case_id"])]))


def _fitted(model: ShapeModel, mesh: Mesh) -> dict[str, object]:
    instance = SurfaceTarget.of(fit_model(model, mesh).vertices, model.faces)
    distance = surface_distance(instance, SurfaceTarget.of(mesh.vertices, mesh.faces))
    return {
        "case_id": mesh.case_id,
        "modes": model.mode_count,
        "surface_mm": distance.mean,
        "hd95_mm": distance.hd95,
    }

"""One method's shape model, scored: what the report's tables and curves are made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ssm_pipeline.evaluation.correspondence_quality import correspondence_quality
from ssm_pipeline.evaluation.model_quality import (
    compactness,
    generalisation,
    held_out_folds,
    mean_over_cases,
    move_meshes,
)
from ssm_pipeline.evaluation.settings import EvaluationSettings
from ssm_pipeline.evaluation.specificity import specificity
from ssm_pipeline.records import CorrespondedShapes, Mesh, Metrics
from ssm_pipeline.shape_model.alignment import align
from ssm_pipeline.shape_model.pca import build


def evaluate_method(
    name: str,
    corresponded: CorrespondedShapes,
    meshes: Sequence[Mesh],
    settings: EvaluationSettings,
    seed: int,
    with_scale: bool = False,
    jobs: int = 1,
    patients: Mapping[str, str] | None = None,
) -> Metrics:
    """Score one method's correspondences and the shape model they give.

    corresponded  N >= 4 shapes in each case's own millimetres, not yet aligned; no faces for
                  methods that give point clouds, whose columns on triangles are then empty.
    meshes        the cases' original meshes in their own millimetres, in any order.
    with_scale    whether the alignment removes size; distances are then those of scaled shapes.
    jobs          processes for the draws; the numbers do not depend on it.
    patients      case id → patient, where one has several cases: they are held out together.

    Returns tables, each with the columns method and seed:
    compactness          a row per number of modes;
    generalisation       a row per case and number of modes;
    generalisation_mean  the same over the cases, with standard errors;
    specificity          a row per number of modes, with standard errors;
    correspondence       a row per case, before any PCA.
    Raises StudyError for fewer than 4 cases, impossible folds or cases without a mesh.
    """
    aligned, frames = align(corresponded, with_scale=with_scale)
    moved = move_meshes(meshes, corresponded.case_ids, frames)
    model = build(aligned)
    # A stream each, so that one table doesn't change when another asks for more draws.
    for_cases, for_draws, for_fit = np.random.default_rng(seed).spawn(3)
    groups = [patients[i] for i in corresponded.case_ids] if patients is not None else None
    folds = held_out_folds(len(moved), settings.folds, seed, groups)
    per_case = generalisation(aligned, moved, settings, for_cases, with_scale, folds)
    # Generalisation's numbers of modes, and all: a comparison needs both at the same number.
    numbers = sorted({*per_case["modes"], model.mode_count})
    tables = {
        "compactness": compactness(model),
        "generalisation": per_case,
        "generalisation_mean": mean_over_cases(per_case),
        "specificity": specificity(model, moved, settings, for_draws, jobs, numbers),
        "correspondence": correspondence_quality(aligned, moved, settings, for_fit),
    }
    for table in tables.values():
        table.insert(0, "method", name)
        table["seed"] = seed
    return Metrics(tables)

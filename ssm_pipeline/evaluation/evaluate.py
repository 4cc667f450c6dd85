"""One method's shape model, scored: what the report's tables and curves are made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ssm_pipeline.evaluation.aligned_cohort import align_cohort
from ssm_pipeline.evaluation.correspondence_quality import correspondence_quality
from ssm_pipeline.evaluation.model_quality import (
    compactness,
    generalisation,
    held_out_folds,
    mean_over_cases,
    most_modes,
)
from ssm_pipeline.evaluation.settings import EvaluationSettings
from ssm_pipeline.evaluation.specificity import specificity
from ssm_pipeline.evaluation.specificity_jackknife import without_each
from ssm_pipeline.evaluation.surface_fits import fits_to_held_out
from ssm_pipeline.records import CorrespondedShapes, Mesh, Metrics
from ssm_pipeline.shape_model.pca import pca_model


@dataclass(frozen=True)
class Scoring:
    """How methods are scored: the same for all that are compared.

    Attributes:
        seed: Of points, draws and folds.
        with_scale: Whether the alignment removes size; distances are then those of scaled shapes.
        jobs: Processes for the draws; the numbers do not depend on it.
        patients: Case id → patient: those of one are held out together; None: each its own.
    """

    settings: EvaluationSettings
    seed: int
    with_scale: bool = False
    jobs: int = 1
    patients: Mapping[str, str] | None = None


def evaluate_method(
    name: str,
    corresponded: CorrespondedShapes,
    meshes: Sequence[Mesh],
    scoring: Scoring,
    fitted: np.ndarray | None = None,
) -> Metrics:
    """Score one method's correspondences and the shape model they give.

    Args:
        name: The value of the column `method`.
        corresponded: N >= 4 shapes in each case's own millimetres, not yet aligned.
        meshes: The cases' original meshes in their own millimetres, in any order.
        fitted: `(N, V, 3)` mm, the shapes before they were projected onto the cases' surfaces. None
            for a method whose points are the cases' own vertices.

    Returns:
        Tables, each with the columns method and seed: compactness, a row per number of modes;
        generalisation, a row per case and number of modes, with the patient where one has several;
        generalisation_mean, the same over the cases, with standard errors; surface_fits, a row per
        case: the model without it, fitted to its surface; specificity, a row per number of modes,
        with standard errors; specificity_draws and specificity_jackknife, for the intervals of its
        differences (`evaluation.paired`); correspondence, a row per case, before any PCA. All hold
        the number of modes that keeps 95 % of the variance.

    Raises:
        StudyError: For fewer than 4 cases, impossible folds or cases without a mesh.
    """
    settings, seed, jobs, patients = scoring.settings, scoring.seed, scoring.jobs, scoring.patients
    cohort, frames = align_cohort(corresponded, meshes, scoring.with_scale)
    model = pca_model(cohort.shapes)
    groups = [patients[i] for i in corresponded.case_ids] if patients is not None else None
    folds = held_out_folds(len(frames), settings.folds, seed, groups)
    # A stream each, so that one table doesn't change when another asks for more draws.
    streams = np.random.default_rng(seed).spawn(4)
    for_cases, for_draws, for_fit, for_spread = streams
    limit, holding = most_modes(folds), model.modes_for(0.95)
    per_case = generalisation(cohort, settings, for_cases, folds, [holding])
    if patients is not None and len(set(patients.values())) < len(patients):
        per_case.insert(1, "patient", per_case["case_id"].map(patients))
    # Generalisation's numbers of modes, and all: a comparison needs both at the same number.
    numbers = sorted({*per_case["modes"], holding, model.mode_count})
    drawn, per_draw = specificity(model, cohort.meshes, settings, for_draws, jobs, numbers)
    if fitted is not None:
        fitted = np.stack([f.apply(shape) for f, shape in zip(frames, fitted, strict=True)])
    tables = {
        "compactness": compactness(model),
        "generalisation": per_case,
        "generalisation_mean": mean_over_cases(per_case),
        "specificity": drawn,
        "specificity_draws": per_draw,
        "correspondence": correspondence_quality(cohort, settings, for_fit, fitted),
    }
    if settings.jackknife_samples:
        tables["specificity_jackknife"] = without_each(
            cohort, limit, settings, for_spread, jobs, groups
        )
    if settings.fit_surfaces:
        tables["surface_fits"] = fits_to_held_out(cohort, folds, limit, jobs)
    for table in tables.values():
        table.insert(0, "method", name)
        table["seed"] = seed
    return Metrics(tables)

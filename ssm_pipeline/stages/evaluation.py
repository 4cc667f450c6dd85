"""Score the shape model, and those of the methods it is compared with, on the same meshes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.comparison.anatomy import Anatomy, anatomy_of, means_of_methods, without_pairs
from ssm_pipeline.comparison.compared_methods import (
    MissingPackage,
    corresponded_shapes,
    fitted_shapes,
    method_folder,
)
from ssm_pipeline.comparison.retrained_folds import unseen_tables
from ssm_pipeline.engine.keys import key_of, key_of_arrays
from ssm_pipeline.engine.per_case import CaseTask, Row
from ssm_pipeline.engine.stage import Outcome
from ssm_pipeline.methods import FULL, TRUTH
from ssm_pipeline.records import CaseError, CorrespondedShapes, Mesh, Metrics
from ssm_pipeline.runs.context import SCORES, Context, patients_of
from ssm_pipeline.runs.run import Run
from ssm_pipeline.study.settings import StudySettings
from ssm_pipeline.study.sources import Luna16Data


def evaluate_methods(context: Context) -> Outcome:
    """<method>/scores/*.csv a method, the same tables of all together, and comparison.csv."""
    from ssm_pipeline.evaluation.interpolation_quality import interpolation_tables
    from ssm_pipeline.evaluation.phantom_truth import recovered_modes, true_correspondence
    from ssm_pipeline.evaluation.tables import (
        comparisons,
        joined,
        with_unseen,
        with_variance_kept,
    )
    from ssm_pipeline.shape_model.alignment import align
    from ssm_pipeline.shape_model.pca import pca_model

    run, settings = Run(context.run_folder), context.settings
    meshes = [run.mesh(case_id) for case_id in context.case_keys]
    anatomy = anatomy_of(context, meshes)
    scores: dict[str, Metrics] = {}
    left_out: list[dict[str, str]] = []
    for method in (FULL, *(method for method in settings.comparison.methods if method != FULL)):
        try:
            shapes = corresponded_shapes(context, run, method, meshes)
        except (CaseError, MissingPackage) as error:  # such a row does not end the study
            context.terminal.say(f"      {method} left out: {error}")
            left_out.append({"method": method, "reason": str(error)})
            continue
        scores[method] = _scores(context, method, settings, shapes, meshes, anatomy)
    truth, template = context.cohort.truth, _template_of(run.shapes)
    if truth is not None:
        true_shapes = true_correspondence(template, truth, tuple(context.case_keys))
        scores[TRUTH] = _scores(context, TRUTH, settings, true_shapes, meshes, anatomy)
    draws, is_luna16 = settings.evaluation.bootstrap_draws, isinstance(settings.data, Luna16Data)
    patients = patients_of(context, list(context.case_keys))
    anatomical = means_of_methods(scores, draws, settings.seed, patients)
    label_pairs = {
        method: metrics.tables["label_pairs"]
        for method, metrics in scores.items()
        if "label_pairs" in metrics.tables
    }
    scores = without_pairs(scores)
    tables = joined(scores) | comparisons(scores, draws, settings.seed, with_paper=is_luna16)
    tables |= anatomical
    if truth is not None:
        tables = with_variance_kept(tables)
    tables["nearest_case"] = _nearest_cases(run, settings, meshes)
    if left_out:
        tables["left_out"] = pd.DataFrame(left_out)
    if settings.comparison.retrain:
        unseen = unseen_tables(context, settings, meshes, anatomy, label_pairs)
        tables = with_unseen(tables, unseen, draws, settings.seed)
    if truth is not None and not settings.shape_model.with_scale:
        floor = pca_model(align(true_shapes)[0])
        tables["recovered_modes"] = recovered_modes(run.model, floor, template, truth)
    tables |= interpolation_tables([run.path(case_id) for case_id in run.path_cases])
    for path in context.folder().glob("*.csv"):
        if path.stem not in tables:  # of other settings; a reader would take it for this run's
            path.unlink()
    storage.save_tables(Metrics(tables), context.folder())
    return Outcome(context.case_keys, note=f"{len(scores)} methods")


def _nearest_cases(run: Run, settings: StudySettings, meshes: Sequence[Mesh]) -> pd.DataFrame:
    """The distance of each case to the nearest other, as the full method's model aligns them."""
    from ssm_pipeline.evaluation.aligned_cohort import move_meshes
    from ssm_pipeline.evaluation.nearest_case import nearest_other_cases

    frames = run.frames
    case_ids = [mesh.case_id for mesh in meshes]
    moved = move_meshes(meshes, case_ids, [frames[case_id] for case_id in case_ids])
    generator = np.random.default_rng(settings.seed)
    return nearest_other_cases(moved, settings.evaluation, generator)


def _scores(
    context: Context,
    method: str,
    settings: StudySettings,
    shapes: CorrespondedShapes,
    meshes: Sequence[Mesh],
    anatomy: Anatomy,
) -> Metrics:
    """A method's tables, from its folder if they are up to date. Raises CaseError."""
    folder = method_folder(context, method)
    mesh_keys = context.done["meshing"].case_keys
    key = key_of(
        SCORES,
        method,
        key_of_arrays(shapes.vertices, shapes.faces),
        [mesh_keys[case_id] for case_id in shapes.case_ids],
        shapes.template_id,
        settings.evaluation,
        settings.shape_model,
        settings.seed,
        patients_of(context, shapes.case_ids),
        {case_id: positions.tolist() for case_id, positions in anatomy.landmarks.items()},
    )
    work = partial(_write_scores, context, method, settings, shapes, meshes, anatomy)
    (result,) = context.map_cases([CaseTask("scores", key, work)], folder, in_this_process=True)
    if result.dropped is not None:
        raise CaseError(method, result.dropped)
    return storage.load_tables(folder / "scores")


def _write_scores(
    context: Context,
    method: str,
    settings: StudySettings,
    shapes: CorrespondedShapes,
    meshes: Sequence[Mesh],
    anatomy: Anatomy,
    folder: Path,
) -> Row:
    """The tables of `evaluate_method`, anatomy's, and of a synthetic cohort the truth's."""
    from ssm_pipeline.evaluation.evaluate import Scoring, evaluate_method

    scoring = Scoring(
        settings.evaluation,
        settings.seed,
        settings.shape_model.with_scale,
        context.jobs,
        patients_of(context, shapes.case_ids),
    )
    metrics = evaluate_method(method, shapes, meshes, scoring, fitted_shapes(context, method))
    storage.save_tables(metrics, folder)
    points, seed = settings.evaluation.points, settings.seed
    storage.save_tables(Metrics(anatomy.tables(method, shapes, meshes, points, seed)), folder)
    truth = context.cohort.truth
    if truth is not None:
        from ssm_pipeline.evaluation.phantom_truth import correspondence_errors, variance_kept

        template, with_scale = _template_of(shapes), settings.shape_model.with_scale
        errors = correspondence_errors(shapes, template, truth)
        errors.insert(0, "method", method)
        kept = 100 * variance_kept(shapes, template, truth, with_scale)
        row = pd.DataFrame([{"method": method, "variance_kept_percent": kept}])
        storage.save_tables(Metrics({"truth": errors, "variance_kept": row}), folder)
    return {}


def _template_of(shapes: CorrespondedShapes) -> Mesh:
    """The template as matched: its own points, which groupwise rounds and S3M choose themselves."""
    return Mesh(shapes.template, shapes.faces, shapes.template_id)

"""Generalisation where the matcher, too, has never seen the cases that it is asked about.

In every other row the networks are trained once, on all cases (without labels), and only the shape
model leaves cases out. Here each fold has a matcher, a template and a model of the kept cases.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.engine.per_case import CaseTask, Row
from ssm_pipeline.methods import FULL, RETRAINED
from ssm_pipeline.records import CaseError, CorrespondedShapes, Mesh
from ssm_pipeline.stages.compared_methods import matched_shapes
from ssm_pipeline.stages.context import Context, patients_of, training_bases
from ssm_pipeline.stages.groupwise import after_rounds
from ssm_pipeline.stages.resumable_training import matcher_of_cases
from ssm_pipeline.study.settings import StudySettings


def retrained_generalisation(
    context: Context, settings: StudySettings, meshes: Sequence[Mesh]
) -> pd.DataFrame:
    """A row a case and number of modes, the columns of the table `generalisation`.

    `retrained-folds/fold-<k>/` keeps each fold's matcher, template, correspondences and errors; a
    run that was stopped goes on in the middle of a fold. The folds are those of the other methods.
    meshes  in the order of the cases, in their own millimetres.
    Raises StudyError for impossible folds, CaseError for a case that can't be matched.
    """
    from ssm_pipeline.evaluation.model_quality import held_out_folds, most_modes

    patients = patients_of(context, [mesh.case_id for mesh in meshes])
    folds = held_out_folds(
        len(meshes), settings.evaluation.folds, settings.seed, list(patients.values())
    )
    tables = []
    for number, held_out in enumerate(folds, start=1):
        folder = context.folder() / "retrained-folds" / f"fold-{number}"
        label = f"training without fold {number} of {len(folds)}"
        kept = [mesh for case, mesh in enumerate(meshes) if case not in held_out]
        seen = [mesh.case_id for mesh in kept]
        matcher_path = matcher_of_cases(context, seen, settings.training, folder, label)
        template_id = _template(context, matcher_path, kept)
        template = next(mesh for mesh in kept if mesh.case_id == template_id)
        rests_on = (matcher_path.stem, template_id)
        shapes = matched_shapes(context, FULL, template, matcher_path, rests_on, meshes, folder)
        shapes = after_rounds(context, shapes, meshes, folder, mean_of=seen)
        key = context.key_of(
            rests_on,
            settings.adaptation,
            settings.groupwise,
            settings.evaluation,
            settings.shape_model,
            settings.seed,
            held_out.tolist(),
        )
        limit = most_modes(folds)
        work = partial(_write_errors, settings, shapes, meshes, held_out, limit, number)
        (result,) = context.map_cases([CaseTask("errors", key, work)], jobs=1, folder=folder)
        if result.dropped is not None:
            raise CaseError(f"fold {number}", result.dropped)
        tables.append(storage.load_tables(folder / "errors").tables["generalisation"])
    table = pd.concat(tables, ignore_index=True)
    table.insert(0, "method", RETRAINED)
    return table.assign(seed=settings.seed)


def _template(context: Context, matcher_path: Path, kept: Sequence[Mesh]) -> str:
    """The study's own choice if it is among the kept cases, else the matcher's, kept beside it."""
    case_ids = [mesh.case_id for mesh in kept]
    if context.settings.template in case_ids:
        return str(context.settings.template)
    from ssm_pipeline.training.matcher import load_matcher
    from ssm_pipeline.training.template import choose_template

    path = matcher_path.with_suffix(".template.json")
    if not path.exists():
        matcher = load_matcher(matcher_path, context.device)
        template_id, _ = choose_template(matcher, training_bases(context, case_ids))
        storage.write_json(path, {"template_id": template_id})
    return str(storage.read_json(path)["template_id"])


def _write_errors(
    settings: StudySettings,
    shapes: CorrespondedShapes,
    meshes: Sequence[Mesh],
    held_out: np.ndarray,
    limit: int,
    number: int,
    folder: Path,
) -> Row:
    """generalisation.csv of one fold."""
    from ssm_pipeline.evaluation.model_quality import held_out_errors, move_meshes
    from ssm_pipeline.evaluation.sampling import FixedPoints
    from ssm_pipeline.records import Metrics
    from ssm_pipeline.shape_model.alignment import align

    evaluation, with_scale = settings.evaluation, settings.shape_model.with_scale
    aligned, frames = align(shapes, with_scale=with_scale)
    moved = move_meshes(meshes, shapes.case_ids, frames)
    generator = np.random.default_rng([settings.seed, number])
    mean = aligned.vertices.mean(axis=0)
    points = FixedPoints.of(mean, aligned.faces, evaluation.points, generator)
    errors = held_out_errors(
        aligned, moved, held_out, limit, points, evaluation, generator, with_scale
    )
    storage.save_tables(Metrics({"generalisation": errors}), folder)
    return {"cases": len(held_out)}

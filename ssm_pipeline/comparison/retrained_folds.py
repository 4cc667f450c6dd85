"""Unseen cases: everything that is learned, learned anew without each fold.

In every other table the networks are trained once, on all cases (without labels), and the groupwise
mean is of all of them; only the shape model leaves cases out. Here each fold has networks, a
template, means and S3M of the kept cases alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.comparison.anatomy import Anatomy
from ssm_pipeline.comparison.compared_methods import Learned, MissingPackage, shapes_of
from ssm_pipeline.engine.keys import key_of_arrays
from ssm_pipeline.engine.per_case import CaseTask, Row
from ssm_pipeline.methods import FULL, ONE_CASE_AT_A_TIME, Method
from ssm_pipeline.records import CaseError, CorrespondedShapes, Mesh
from ssm_pipeline.runs.context import SCORES, Context, patients_of, training_bases
from ssm_pipeline.runs.resumable_training import matcher_of_cases
from ssm_pipeline.study.settings import StudySettings

TABLES = ("unseen_generalisation", "unseen_specificity")
_PAIRS = "unseen_label_pairs"


@dataclass(frozen=True, eq=False)
class Fold:
    """One of `count` folds: the places of its held-out cases, and what was learned without them."""

    number: int
    held_out: np.ndarray
    modes: int  # the most that the models of all folds have
    learned: Learned


def learning_methods(settings: StudySettings) -> tuple[Method, ...]:
    """The rows of the comparison that learn from other cases than the one they match.

    The others meet every case as if it were unseen; their row of the k-fold table holds.
    """
    methods: tuple[Method, ...] = (FULL, *settings.comparison.methods)
    learning = [method for method in methods if method not in ONE_CASE_AT_A_TIME]
    return tuple(dict.fromkeys(learning))


def unseen_tables(
    context: Context,
    settings: StudySettings,
    meshes: Sequence[Mesh],
    anatomy: Anatomy,
    label_pairs: Mapping[str, pd.DataFrame],
) -> dict[str, pd.DataFrame]:
    """unseen_generalisation: a row per method, case and number of modes, as `generalisation` has.
    unseen_specificity: a row per method and fold (`evaluation.unseen`).
    unseen_labels_mean: where the cases have labels, these carried from kept cases to held-out ones,
    a row per method (`evaluation.carried_labels`).

    `retrained-folds/fold-<k>/` keeps what each fold learned, its correspondences and scores; a run
    that was stopped goes on where it was. The folds are those of the other tables.
    meshes       in the order of the cases, in their own millimetres.
    label_pairs  method → labels carried from every case to every other, of the whole run: the rows
                 that do not learn are judged by them, on the same pairs.
    Raises StudyError for impossible folds, CaseError for a case that can't be matched.
    """
    folds = _folds(context, settings, meshes)
    tables: dict[str, list[pd.DataFrame]] = {name: [] for name in TABLES}
    pairs: dict[str, pd.DataFrame] = {}
    for method in learning_methods(settings):
        try:
            found = [_scores(context, settings, fold, method, meshes, anatomy) for fold in folds]
        except MissingPackage:
            continue  # said where the row itself was left out
        for name in TABLES:
            tables[name] += [scores[name].assign(method=method) for scores in found]
        if anatomy.labels:
            pairs[method] = pd.concat([scores[_PAIRS] for scores in found], ignore_index=True)
    result = {
        name: pd.concat(parts, ignore_index=True).assign(seed=settings.seed)
        for name, parts in tables.items()
    }
    if FULL in pairs:
        patients = patients_of(context, [mesh.case_id for mesh in meshes])
        result["unseen_labels_mean"] = _label_means(settings, pairs, label_pairs, patients)
    return result


def _label_means(
    settings: StudySettings,
    unseen: Mapping[str, pd.DataFrame],
    of_the_run: Mapping[str, pd.DataFrame],
    patients: Mapping[str, str],
) -> pd.DataFrame:
    from ssm_pipeline.evaluation.carried_labels import label_means

    same = unseen[FULL][["from_case_id", "case_id"]]
    others = {
        method: same.merge(table, on=["from_case_id", "case_id"])
        for method, table in of_the_run.items()
        if method in ONE_CASE_AT_A_TIME
    }
    draws, generator = settings.evaluation.bootstrap_draws, np.random.default_rng(settings.seed)
    return label_means({**unseen, **others}, FULL, draws, generator, patients)


def _folds(context: Context, settings: StudySettings, meshes: Sequence[Mesh]) -> list[Fold]:
    from ssm_pipeline.evaluation.model_quality import held_out_folds, most_modes

    patients = list(patients_of(context, [mesh.case_id for mesh in meshes]).values())
    parts = held_out_folds(len(meshes), settings.evaluation.folds, settings.seed, patients)
    folds = []
    for number, held_out in enumerate(parts, start=1):
        folder = context.folder() / "retrained-folds" / f"fold-{number}"
        label = f"training without fold {number} of {len(parts)}"
        kept = [mesh for case, mesh in enumerate(meshes) if case not in held_out]
        seen = tuple(mesh.case_id for mesh in kept)
        matcher = matcher_of_cases(context, seen, settings.training, folder, label)
        template_id = _template(context, matcher, kept)
        template = next(mesh for mesh in kept if mesh.case_id == template_id)
        learned = Learned(matcher, (matcher.stem, template_id), template, seen, folder)
        folds.append(Fold(number, held_out, most_modes(parts), learned))
    return folds


def _template(context: Context, matcher_path: Path, kept: Sequence[Mesh]) -> str:
    """The study's own choice if it is among the kept cases, else the matcher's, kept beside it."""
    case_ids = [mesh.case_id for mesh in kept]
    if context.settings.template in case_ids:
        return str(context.settings.template)
    from ssm_pipeline.training.matcher import load_matcher
    from ssm_pipeline.training.template_choice import choose_template

    path = matcher_path.with_suffix(".template.json")
    if not path.exists():
        matcher = load_matcher(matcher_path, context.device)
        template_id, _ = choose_template(matcher, training_bases(context, case_ids))
        storage.write_json(path, {"template_id": template_id})
    return str(storage.read_json(path)["template_id"])


def _scores(
    context: Context,
    settings: StudySettings,
    fold: Fold,
    method: Method,
    meshes: Sequence[Mesh],
    anatomy: Anatomy,
) -> dict[str, pd.DataFrame]:
    """A method's tables of one fold, up to date. Raises CaseError, MissingPackage."""
    shapes = shapes_of(context, fold.learned, method, meshes)
    folder = fold.learned.folder / "scores"
    key = context.key_of(
        SCORES,
        method,
        key_of_arrays(shapes.vertices, shapes.faces),
        settings.evaluation,
        settings.shape_model,
        settings.seed,
        fold.held_out.tolist(),
    )
    work = partial(_write_scores, settings, method, shapes, meshes, fold, anatomy)
    name = method.replace(",", "").replace(" ", "-")
    (result,) = context.map_cases([CaseTask(name, key, work)], folder, in_this_process=True)
    if result.dropped is not None:
        raise CaseError(f"fold {fold.number}", result.dropped)
    return storage.load_tables(folder / name).tables


def _write_scores(
    settings: StudySettings,
    method: Method,
    shapes: CorrespondedShapes,
    meshes: Sequence[Mesh],
    fold: Fold,
    anatomy: Anatomy,
    folder: Path,
) -> Row:
    """unseen_generalisation.csv, unseen_specificity.csv and unseen_label_pairs.csv of a fold."""
    from ssm_pipeline.evaluation.aligned_cohort import align_cohort
    from ssm_pipeline.evaluation.model_quality import held_out_errors
    from ssm_pipeline.evaluation.sampling import FixedPoints
    from ssm_pipeline.evaluation.unseen import unseen_specificity
    from ssm_pipeline.records import Metrics

    evaluation = settings.evaluation
    cohort, _ = align_cohort(shapes, meshes, settings.shape_model.with_scale)
    for_cases, for_draws = np.random.default_rng([settings.seed, fold.number]).spawn(2)
    mean = cohort.shapes.vertices.mean(axis=0)
    points = FixedPoints.of(mean, shapes.faces, evaluation.points, for_cases)
    errors = held_out_errors(cohort, fold.held_out, fold.modes, points, evaluation, for_cases)
    row = unseen_specificity(cohort, fold.held_out, fold.modes, evaluation, for_draws)
    tables = {
        "unseen_generalisation": errors,
        "unseen_specificity": pd.DataFrame([{"fold": fold.number} | row]),
    }
    if anatomy.labels:
        carried = anatomy.tables(method, shapes, meshes, evaluation.points, settings.seed)
        pairs, held_out = carried["label_pairs"], [shapes.case_ids[case] for case in fold.held_out]
        is_asked = pairs["case_id"].isin(held_out) & ~pairs["from_case_id"].isin(held_out)
        tables[_PAIRS] = pairs[is_asked]
    storage.save_tables(Metrics(tables), folder)
    return {"cases": len(fold.held_out)}

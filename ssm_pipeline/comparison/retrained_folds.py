"""Unseen cases: everything that is learned is learned again without each fold.

In every other table the networks are trained once, on all cases (without labels), and the groupwise
mean is that of all cases; only the shape model leaves cases out. Here the networks, the template,
the means and S3M of a fold are made of the kept cases only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.comparison.inputs import ComparisonInputs, MethodUnavailable, keep_result
from ssm_pipeline.comparison.producers import Learned, produce
from ssm_pipeline.comparison.scores import SCORES
from ssm_pipeline.engine.keys import key_of, key_of_arrays
from ssm_pipeline.engine.per_case import CaseTask, Row
from ssm_pipeline.methods import FULL, folder_name, learns
from ssm_pipeline.records import CorrespondedShapes, Metrics
from ssm_pipeline.runs.resumable_training import matcher_of_cases
from ssm_pipeline.study.settings import StudySettings

TABLES = ("unseen_generalisation", "unseen_specificity")
_PAIRS = "unseen_label_pairs"


@dataclass(frozen=True, eq=False)
class Fold:
    """A fold: the indices of its held-out cases, and what was learned without them."""

    number: int
    held_out: np.ndarray
    modes: int  # the largest number that the models of all folds have
    learned: Learned


def learning_methods(settings: StudySettings) -> tuple[str, ...]:
    """The compared methods that learn from other cases than the one they match.

    To the others every case is unseen, so that their ordinary scores hold.
    """
    return tuple(filter(learns, dict.fromkeys((FULL, *settings.comparison.methods))))


def unseen_tables(
    inputs: ComparisonInputs, label_pairs: Mapping[str, pd.DataFrame]
) -> dict[str, pd.DataFrame]:
    """The scores of cases that nothing was learned from.

    `retrained-folds/fold-<k>/` keeps what each fold learned, its correspondences and its scores, so
    that a run that was stopped continues. The folds are those of the other tables.

    Args:
        label_pairs: Method → the labels transferred from every case to every other, of the whole
            run. They are the scores of the methods that do not learn, on the same pairs.

    Returns:
        unseen_generalisation: A row per method, case and number of modes, as in `generalisation`.
        unseen_specificity: A row per method and fold (`evaluation.unseen`).
        unseen_labels_mean: Where the cases have labels, a row per method: labels transferred from
            kept cases to held-out ones (`evaluation.carried_labels`).

    Raises:
        StudyError: The folds are impossible.
        CaseError: A case can't be matched.
    """
    folds = _folds(inputs)
    tables: dict[str, list[pd.DataFrame]] = {name: [] for name in TABLES}
    pairs: dict[str, pd.DataFrame] = {}
    for method in learning_methods(inputs.settings):
        try:
            found = [fold_scores(inputs, fold, method) for fold in folds]
        except MethodUnavailable:
            continue  # reported where the row itself was left out
        for name in TABLES:
            tables[name] += [scores[name].assign(method=method) for scores in found]
        if inputs.anatomy.labels:
            pairs[method] = pd.concat([scores[_PAIRS] for scores in found], ignore_index=True)
    result = {
        name: pd.concat(parts, ignore_index=True).assign(seed=inputs.seed)
        for name, parts in tables.items()
    }
    if FULL in pairs:
        result["unseen_labels_mean"] = _label_means(inputs, pairs, label_pairs)
    return result


def _label_means(
    inputs: ComparisonInputs,
    unseen: Mapping[str, pd.DataFrame],
    of_the_run: Mapping[str, pd.DataFrame],
) -> pd.DataFrame:
    from ssm_pipeline.evaluation.carried_labels import label_means

    same = unseen[FULL][["from_case_id", "case_id"]]
    others = {
        method: same.merge(table, on=["from_case_id", "case_id"])
        for method, table in of_the_run.items()
        if not learns(method)
    }
    draws, generator = (
        inputs.settings.evaluation.bootstrap_draws,
        np.random.default_rng(inputs.seed),
    )
    return label_means({**unseen, **others}, FULL, draws, generator, inputs.patients)


def _folds(inputs: ComparisonInputs) -> list[Fold]:
    from ssm_pipeline.evaluation.model_quality import held_out_folds, most_modes

    settings, meshes = inputs.settings, inputs.meshes
    patients = [inputs.patients[mesh.case_id] for mesh in meshes]
    parts = held_out_folds(len(meshes), settings.evaluation.folds, settings.seed, patients)
    folds = []
    for number, held_out in enumerate(parts, start=1):
        folder = inputs.folder / "retrained-folds" / f"fold-{number}"
        label = f"training without fold {number} of {len(parts)}"
        kept = [mesh for case, mesh in enumerate(meshes) if case not in held_out]
        seen = tuple(mesh.case_id for mesh in kept)
        matcher = matcher_of_cases(inputs.training, seen, settings.training, folder, label)
        template_id = _template(inputs, matcher, seen)
        template = next(mesh for mesh in kept if mesh.case_id == template_id)
        learned = Learned(matcher, (matcher.stem, template_id), template, seen, folder)
        folds.append(Fold(number, held_out, most_modes(parts), learned))
    return folds


def _template(inputs: ComparisonInputs, matcher_path: Path, kept: Sequence[str]) -> str:
    """The study's own template if it is among the kept cases, else the matcher's choice.

    The choice is kept in a file beside the matcher.
    """
    if inputs.settings.template in kept:
        return str(inputs.settings.template)
    from ssm_pipeline.training.matcher import load_matcher
    from ssm_pipeline.training.template_choice import choose_template

    path = matcher_path.with_suffix(".template.json")
    if not path.exists():
        matcher = load_matcher(matcher_path, inputs.device)
        template_id, _ = choose_template(matcher, inputs.training.load_bases(kept))
        storage.write_json(path, {"template_id": template_id})
    return str(storage.read_json(path)["template_id"])


def fold_scores(inputs: ComparisonInputs, fold: Fold, method: str) -> dict[str, pd.DataFrame]:
    """A method's tables of one fold, up to date. Raises CaseError, MethodUnavailable."""
    shapes, settings = produce(inputs, fold.learned, method).shapes, inputs.settings
    key = key_of(
        "evaluation",
        dict(inputs.case_keys),
        SCORES,
        method,
        key_of_arrays(shapes.vertices, shapes.faces),
        settings.evaluation,
        settings.shape_model,
        settings.seed,
        fold.held_out.tolist(),
    )
    task = CaseTask(folder_name(method), key, partial(_write_fold, inputs, fold, method, shapes))
    folder = keep_result(inputs, f"fold {fold.number}", task, fold.learned.folder / "scores")
    return storage.load_tables(folder).tables


def _write_fold(
    inputs: ComparisonInputs, fold: Fold, method: str, shapes: CorrespondedShapes, folder: Path
) -> Row:
    """unseen_generalisation.csv, unseen_specificity.csv and unseen_label_pairs.csv of a fold."""
    from ssm_pipeline.evaluation.aligned_cohort import align_cohort
    from ssm_pipeline.evaluation.model_quality import held_out_errors
    from ssm_pipeline.evaluation.sampling import FixedPoints
    from ssm_pipeline.evaluation.unseen import unseen_specificity

    settings, evaluation = inputs.settings, inputs.settings.evaluation
    cohort, _ = align_cohort(shapes, inputs.meshes, settings.shape_model.with_scale)
    for_cases, for_draws = np.random.default_rng([settings.seed, fold.number]).spawn(2)
    mean = cohort.shapes.vertices.mean(axis=0)
    points = FixedPoints.of(mean, shapes.faces, evaluation.points, for_cases)
    errors = held_out_errors(cohort, fold.held_out, fold.modes, points, evaluation, for_cases)
    row = unseen_specificity(cohort, fold.held_out, fold.modes, evaluation, for_draws)
    tables = {
        "unseen_generalisation": errors,
        "unseen_specificity": pd.DataFrame([{"fold": fold.number} | row]),
    }
    if inputs.anatomy.labels:
        points_per_case, seed = evaluation.points, settings.seed
        carried = inputs.anatomy.tables(method, shapes, inputs.meshes, points_per_case, seed)
        pairs, held_out = carried["label_pairs"], [shapes.case_ids[case] for case in fold.held_out]
        counts = pairs["case_id"].isin(held_out) & ~pairs["from_case_id"].isin(held_out)
        tables[_PAIRS] = pairs[counts]
    storage.save_tables(Metrics(tables), folder)
    return {"cases": len(fold.held_out)}

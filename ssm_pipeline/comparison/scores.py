"""The scores of each method, kept in its folder."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.comparison.inputs import ComparisonInputs, MethodUnavailable, keep_result
from ssm_pipeline.comparison.producers import Learned, produce, template_as_matched
from ssm_pipeline.engine.keys import key_of, key_of_arrays
from ssm_pipeline.engine.per_case import CaseTask, Row
from ssm_pipeline.methods import folder_name
from ssm_pipeline.records import CaseError, Metrics
from ssm_pipeline.shape_model.cohort_matching import MatchedCohort

SCORES = 3  # version of the scores: raise it where what they hold or mean changes


@dataclass(frozen=True)
class ScoredMethods:
    """Method → its scores; and the reason for each method that is left out."""

    scores: dict[str, Metrics]
    left_out: dict[str, str]


def score_methods(
    inputs: ComparisonInputs, learned: Learned, names: Iterable[str]
) -> ScoredMethods:
    """Make the shapes of each method and score them; what is up to date is read.

    A method that can't do a case or is unavailable is left out, and the study continues.
    """
    scores: dict[str, Metrics] = {}
    left_out: dict[str, str] = {}
    for name in names:
        try:
            matched = produce(inputs, learned, name)
        except (CaseError, MethodUnavailable) as error:
            inputs.terminal.detail(f"{name} left out: {error}")
            left_out[name] = str(error)
            continue
        scores[name] = method_scores(inputs, name, matched)
    return ScoredMethods(scores, left_out)


def method_scores(inputs: ComparisonInputs, name: str, matched: MatchedCohort) -> Metrics:
    """The tables of a method, kept in its folder.

    Raises:
        CaseError: The shapes can't be scored.
    """
    settings, shapes = inputs.settings, matched.shapes
    key = key_of(
        SCORES,
        name,
        key_of_arrays(shapes.vertices, shapes.faces),
        [inputs.mesh_keys[case_id] for case_id in shapes.case_ids],
        shapes.template_id,
        settings.evaluation,
        settings.shape_model,
        settings.seed,
        inputs.patients_of(shapes.case_ids),
        {case_id: points.tolist() for case_id, points in inputs.anatomy.landmarks.items()},
    )
    task = CaseTask("scores", key, partial(_write_scores, inputs, name, matched))
    return storage.load_tables(keep_result(inputs, name, task, inputs.folder / folder_name(name)))


def _write_scores(inputs: ComparisonInputs, name: str, matched: MatchedCohort, folder: Path) -> Row:
    """The tables of `evaluate_method` and of the anatomy, and of a synthetic cohort the truth's."""
    from ssm_pipeline.evaluation.evaluate import Scoring, evaluate_method

    settings, shapes, meshes = inputs.settings, matched.shapes, inputs.meshes
    scoring = Scoring(
        settings.evaluation,
        settings.seed,
        settings.shape_model.with_scale,
        inputs.jobs,
        inputs.patients_of(shapes.case_ids),
    )
    metrics = evaluate_method(name, shapes, meshes, scoring, matched.fitted)
    storage.save_tables(metrics, folder)
    points, seed = settings.evaluation.points, settings.seed
    anatomical = inputs.anatomy.tables(name, shapes, meshes, points, seed)
    storage.save_tables(Metrics(anatomical), folder)
    if inputs.truth is not None:
        from ssm_pipeline.evaluation.phantom_truth import correspondence_errors, variance_kept

        template, with_scale = template_as_matched(shapes), settings.shape_model.with_scale
        errors = correspondence_errors(shapes, template, inputs.truth)
        errors.insert(0, "method", name)
        kept = 100 * variance_kept(shapes, template, inputs.truth, with_scale)
        row = pd.DataFrame([{"method": name, "variance_kept_percent": kept}])
        storage.save_tables(Metrics({"truth": errors, "variance_kept": row}), folder)
    return {}

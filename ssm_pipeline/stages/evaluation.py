"""Score the shape model, and those of the methods it is compared with, on the same meshes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.comparison.anatomy import means_of_methods, pairs_of_methods, without_pairs
from ssm_pipeline.comparison.inputs import ComparisonInputs
from ssm_pipeline.comparison.producers import learned_by_run, produce, template_as_matched
from ssm_pipeline.comparison.retrained_folds import unseen_tables
from ssm_pipeline.comparison.scores import ScoredMethods, score_methods
from ssm_pipeline.counting import counted
from ssm_pipeline.engine.stage import Outcome
from ssm_pipeline.methods import FULL, TRUTH
from ssm_pipeline.records import Mesh, Metrics
from ssm_pipeline.runs.context import Context, run_of
from ssm_pipeline.runs.run import Run
from ssm_pipeline.study.settings import StudySettings
from ssm_pipeline.study.sources import Luna16Data


def evaluate_methods(context: Context) -> Outcome:
    """<method>/scores/*.csv per method, the same tables of all together, and comparison.csv."""
    run = run_of(context)
    inputs = ComparisonInputs.of(context, [run.mesh(i) for i in context.case_keys])
    scored = score_methods(inputs, learned_by_run(inputs, run), compared(inputs))
    tables = method_tables(inputs, scored) | model_tables(inputs, run)
    save_only(tables, inputs.folder)
    return Outcome(inputs.case_keys, note=counted(len(scored.scores), "method"))


def compared(inputs: ComparisonInputs) -> tuple[str, ...]:
    """The methods in the order of their rows: the full one first, and the truth last."""
    truth = () if inputs.truth is None else (TRUTH,)
    return tuple(dict.fromkeys((FULL, *inputs.settings.comparison.methods, *truth)))


def method_tables(inputs: ComparisonInputs, scored: ScoredMethods) -> dict[str, pd.DataFrame]:
    """The tables of all methods together."""
    from ssm_pipeline.evaluation.tables import (
        comparisons,
        joined,
        with_unseen,
        with_variance_kept,
    )

    settings, seed = inputs.settings, inputs.seed
    draws, with_paper = settings.evaluation.bootstrap_draws, isinstance(settings.data, Luna16Data)
    scores = without_pairs(scored.scores)
    tables = joined(scores) | comparisons(scores, draws, seed, with_paper)
    tables |= means_of_methods(scored.scores, draws, seed, inputs.patients)
    if inputs.truth is not None:
        tables = with_variance_kept(tables)
    if scored.left_out:
        tables["left_out"] = pd.DataFrame(scored.left_out.items(), columns=["method", "reason"])
    if settings.comparison.retrain:
        unseen = unseen_tables(inputs, pairs_of_methods(scored.scores, "label"))
        tables = with_unseen(tables, unseen, draws, seed)
    return tables


def model_tables(inputs: ComparisonInputs, run: Run) -> dict[str, pd.DataFrame]:
    """The tables of the run's own model: its nearest cases, its true modes, its interpolations."""
    from ssm_pipeline.evaluation.interpolation_quality import interpolation_tables

    tables = {"nearest_case": _nearest_cases(run, inputs.settings, inputs.meshes)}
    if inputs.truth is not None and not inputs.settings.shape_model.with_scale:
        tables["recovered_modes"] = _recovered_modes(inputs, run)
    return tables | interpolation_tables([run.path(case_id) for case_id in run.path_cases])


def save_only(tables: dict[str, pd.DataFrame], folder: Path) -> None:
    """Save the tables, and delete those of other settings, which a reader would take for these."""
    for path in folder.glob("*.csv"):
        if path.stem not in tables:
            path.unlink()
    storage.save_tables(Metrics(tables), folder)


def _recovered_modes(inputs: ComparisonInputs, run: Run) -> pd.DataFrame:
    from ssm_pipeline.evaluation.phantom_truth import recovered_modes
    from ssm_pipeline.shape_model.alignment import align
    from ssm_pipeline.shape_model.pca import pca_model

    assert inputs.truth is not None
    true_shapes = produce(inputs, learned_by_run(inputs, run), TRUTH).shapes
    floor = pca_model(align(true_shapes)[0])
    return recovered_modes(run.model, floor, template_as_matched(run.shapes), inputs.truth)


def _nearest_cases(run: Run, settings: StudySettings, meshes: Sequence[Mesh]) -> pd.DataFrame:
    """The distance of each case to the nearest other, as the full method's model aligns them."""
    from ssm_pipeline.evaluation.aligned_cohort import move_meshes
    from ssm_pipeline.evaluation.nearest_case import nearest_other_cases

    frames = run.frames
    case_ids = [mesh.case_id for mesh in meshes]
    moved = move_meshes(meshes, case_ids, [frames[case_id] for case_id in case_ids])
    generator = np.random.default_rng(settings.seed)
    return nearest_other_cases(moved, settings.evaluation, generator)

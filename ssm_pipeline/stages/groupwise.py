"""Stage `groupwise`: the mean shape, in the template's place, adapted to every case."""

from __future__ import annotations

from functools import partial

from ssm_pipeline import storage
from ssm_pipeline.counting import counted
from ssm_pipeline.engine.stage import Outcome
from ssm_pipeline.runs.context import Context, run_of
from ssm_pipeline.runs.layout import CORRESPONDENCE, SHAPES
from ssm_pipeline.runs.pair_matching import PairWork, match_mean, matches_in


def match_means(context: Context) -> Outcome:
    """round-<r>/<case>/correspondence.npz, mean shape → case; shapes.npz, the cohort as matched."""
    from ssm_pipeline.shape_model.collected_points import collect
    from ssm_pipeline.shape_model.groupwise_rounds import groupwise_rounds

    run, settings = run_of(context), context.settings.groupwise
    meshes = [run.mesh(case_id) for case_id in context.case_keys]
    matches = matches_in(run.stage_folder(CORRESPONDENCE.stage), context.case_keys)
    shapes = collect(run.mesh(run.template_id), matches, meshes)
    match = partial(match_mean, PairWork.of(context), run.template_id, context.folder())
    shapes = groupwise_rounds(shapes, meshes, settings, match)
    storage.save(shapes, context.folder() / SHAPES.name)
    return Outcome(context.case_keys, note=counted(settings.rounds, "round"))

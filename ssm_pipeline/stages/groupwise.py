"""Stage `groupwise`: the mean shape, in the template's place, adapted to every case."""

from __future__ import annotations

from ssm_pipeline import storage
from ssm_pipeline.engine.stage import Outcome
from ssm_pipeline.runs.context import Context
from ssm_pipeline.runs.mean_rounds import after_rounds
from ssm_pipeline.runs.pair_matching import matched_once
from ssm_pipeline.runs.run import Run


def match_mean(context: Context) -> Outcome:
    """round-<r>/<case>/correspondence.npz, mean shape → case; shapes.npz, the cohort as matched."""
    run = Run(context.run_folder)
    meshes = [run.mesh(case_id) for case_id in context.case_keys]
    shapes = matched_once(context, run.mesh(run.template_id), meshes)
    shapes = after_rounds(context, shapes, meshes, context.folder())
    storage.save(shapes, context.folder() / "shapes.npz")
    return Outcome(context.case_keys, note=f"{context.settings.groupwise.rounds} rounds")

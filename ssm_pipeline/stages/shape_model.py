"""Stage `shape_model`: corresponded shapes aligned, and their principal components."""

from __future__ import annotations

from ssm_pipeline import storage
from ssm_pipeline.counting import counted
from ssm_pipeline.engine.stage import Outcome
from ssm_pipeline.runs.context import Context, run_of
from ssm_pipeline.runs.layout import ALIGNED, FRAMES, MODEL, Frames


def build_model(context: Context) -> Outcome:
    """aligned.npz with frames.npz, and model.npz."""
    from ssm_pipeline.shape_model.alignment import align
    from ssm_pipeline.shape_model.pca import pca_model

    shapes, case_ids = run_of(context).shapes, tuple(context.case_keys)
    aligned, frames = align(shapes, with_scale=context.settings.shape_model.with_scale)
    model = pca_model(aligned)
    folder = context.folder()
    storage.save(aligned, folder / ALIGNED.name)
    storage.save(Frames(case_ids, frames), folder / FRAMES.name)
    model.save(folder / MODEL.name)
    held = counted(model.modes_for(0.9), "holds 90 %", "hold 90 %")
    return Outcome(context.case_keys, note=f"{counted(model.mode_count, 'mode')}, {held}")

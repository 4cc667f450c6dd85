"""Stage `shape_model`: corresponded shapes aligned, and their principal components."""

from __future__ import annotations

from ssm_pipeline import storage
from ssm_pipeline.engine.stage import Outcome
from ssm_pipeline.runs.context import Context
from ssm_pipeline.runs.run import Frames, Run


def build_model(context: Context) -> Outcome:
    """aligned.npz with frames.npz, and model.npz."""
    from ssm_pipeline.shape_model.alignment import align
    from ssm_pipeline.shape_model.pca import pca_model

    shapes, case_ids = Run(context.run_folder).shapes, tuple(context.case_keys)
    aligned, frames = align(shapes, with_scale=context.settings.shape_model.with_scale)
    model = pca_model(aligned)
    folder = context.folder()
    storage.save(aligned, folder / "aligned.npz")
    storage.save(Frames(case_ids, frames), folder / "frames.npz")
    model.save(folder / "model.npz")
    return Outcome(
        context.case_keys, note=f"{model.mode_count} modes, {model.modes_for(0.9)} hold 90 %"
    )

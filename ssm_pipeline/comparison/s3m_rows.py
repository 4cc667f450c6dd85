"""S3M's rows: one training, resumable and kept at several epochs, for every setting that shares it.

`S3M/` in the evaluation's folder holds `losses.csv` (a row per epoch), `network-<key>-<epoch>.pt`,
and each row's corresponded points in a folder of its own.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.baselines.s3m.settings import S3MSettings
from ssm_pipeline.engine.keys import key_of
from ssm_pipeline.engine.left_files import CASE_FILE
from ssm_pipeline.engine.per_case import CaseTask, Row
from ssm_pipeline.records import CaseError, CorrespondedShapes, Mesh
from ssm_pipeline.runs.context import Context

if TYPE_CHECKING:  # at run time inside the functions: reading a finished run needs no PyTorch
    from ssm_pipeline.baselines.s3m.epochs import S3MCheckpoint

LOSSES_FILE = "losses.csv"
KEPT_EPOCHS = (1, 3, 10, 30)  # of a training, where it can be scored afterwards


def s3m_shapes(
    context: Context,
    settings: S3MSettings,
    template: Mesh,
    meshes: Sequence[Mesh],
    folder: Path,
    row: str = "shapes",
    seen: Collection[str] | None = None,
) -> CorrespondedShapes:
    """The cases in S3M's correspondence, each in its own millimetres, up to date in `folder`.

    template  what all cases are aligned to rigidly first, as they are for every other row; S3M
              chooses its reference itself.
    row       the folder's name for these settings; the networks lie beside it.
    seen      the cases that S3M is trained on and chooses its reference among; None: all.
    Raises CaseError for a case that S3M can't do.
    """

    def work(place: Path) -> Row:
        import torch

        from ssm_pipeline.baselines.common_start import meshes_at_common_start
        from ssm_pipeline.baselines.s3m.s3m import match_s3m

        aligned, frames = meshes_at_common_start(template, meshes, context.seed)
        trained = _trained(context, settings, key, aligned, folder, seen)
        with context.terminal.steps("S3M, matching", len(meshes)) as steps:
            match = match_s3m(
                aligned,
                trained,
                settings,
                context.seed,
                torch.device(context.device),
                lambda phase, done, of: steps.advance_to(done),
                seen,
                context.jobs,
            )
        points = zip(frames, match.points.vertices, strict=True)
        own = np.stack([frame.apply(shape) for frame, shape in points])
        storage.save(dataclasses.replace(match.points, vertices=own), place / "points.npz")
        return {"template_id": match.points.template_id}

    # Meshes alone are read: training our networks anew leaves the result as it is.
    mesh_keys = context.done["meshing"].case_keys
    case_ids = [mesh.case_id for mesh in meshes]
    trained_on = [case_id for case_id in case_ids if seen is None or case_id in seen]
    key = training_key(settings, context.seed, mesh_keys, template.case_id, trained_on)
    rests_on = [key, settings, [mesh_keys[case_id] for case_id in case_ids]]
    network = network_path(folder, key, settings.epochs)
    if not network.exists():  # found damaged, and deleted: made again, and the row of it
        storage.remove(folder / row / CASE_FILE)
    (result,) = context.map_cases(
        [CaseTask(row, key_of(rests_on), work)], folder, in_this_process=True
    )
    if result.dropped is not None:
        raise CaseError("in the comparison", result.dropped)
    if not (folder / LOSSES_FILE).exists():  # they were found damaged
        _write_losses(_read(network), folder)
    return storage.load(CorrespondedShapes, folder / row / "points.npz")


def training_key(
    settings: S3MSettings,
    seed: int,
    mesh_keys: Mapping[str, str],
    template_id: str,
    case_ids: Sequence[str],
) -> str:
    """Of what a network depends on: not the filter, nor how many epochs will follow."""
    later = {"kernel_variance_mm2", "kernel_std_share", "epochs"}
    cases = [mesh_keys[case_id] for case_id in case_ids]
    return key_of(settings.model_dump(exclude=later), seed, mesh_keys[template_id], cases)


def network_path(folder: Path, key: str, epoch: int | str) -> Path:
    return folder / f"network-{key}-{epoch}.pt"


def _trained(
    context: Context,
    settings: S3MSettings,
    key: str,
    meshes: Sequence[Mesh],
    folder: Path,
    seen: Collection[str] | None,
) -> S3MCheckpoint:
    """The network after `settings.epochs`: kept, or trained on from the last epoch that is."""
    import torch

    from ssm_pipeline.baselines.s3m.s3m import train_s3m
    from ssm_pipeline.training.matcher import save_tensors

    def path(epoch: int | str) -> Path:
        return network_path(folder, key, epoch)

    if path(settings.epochs).exists():
        kept = _read(path(settings.epochs))
        _write_losses(kept, folder)  # they come after the network, and may be torn
        return kept
    found = {int(p.stem.rpartition("-")[2]): p for p in folder.glob(path("*").name)}
    before = max((epoch for epoch in found if epoch < settings.epochs), default=None)
    start = None if before is None else _read(found[before])
    if start is not None:
        context.terminal.say(f"      S3M goes on after epoch {start.epoch}")
    with context.terminal.steps("S3M, epochs of training", settings.epochs) as steps:

        def on_epoch(checkpoint: S3MCheckpoint) -> None:
            epoch = checkpoint.epoch
            save_tensors(dict(checkpoint.__dict__), path(epoch))
            if epoch - 1 not in KEPT_EPOCHS:  # only ever the last, and those to be scored
                path(epoch - 1).unlink(missing_ok=True)
            _write_losses(checkpoint, folder)
            steps.advance_to(epoch, f"loss {checkpoint.losses[-1]:.3g}")

        return train_s3m(
            [mesh for mesh in meshes if seen is None or mesh.case_id in seen],
            settings,
            context.seed,
            torch.device(context.device),
            lambda phase, done, of: None,
            start,
            on_epoch,
        )


def _write_losses(checkpoint: S3MCheckpoint, folder: Path) -> None:
    losses = pd.DataFrame({"epoch": range(1, checkpoint.epoch + 1), "loss": checkpoint.losses})
    storage.write_table(losses, folder / LOSSES_FILE)


def _read(network: Path) -> S3MCheckpoint:
    from ssm_pipeline.baselines.s3m.epochs import S3MCheckpoint
    from ssm_pipeline.training.matcher import load_tensors

    return S3MCheckpoint(**load_tensors(network))

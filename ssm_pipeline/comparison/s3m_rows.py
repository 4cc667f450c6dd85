"""The rows of S3M: one training, which can be resumed, serves all of them.

`S3M/` in the folder of the evaluation holds `losses.csv` (a row per epoch),
`network-<key>-<epoch>.pt`, and a folder with the corresponded points of each row.
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
from ssm_pipeline.comparison.inputs import ComparisonInputs, keep_result
from ssm_pipeline.engine.keys import key_of
from ssm_pipeline.engine.left_files import CASE_FILE
from ssm_pipeline.engine.per_case import CaseTask, Row
from ssm_pipeline.methods import Method
from ssm_pipeline.records import CorrespondedShapes, Mesh

if TYPE_CHECKING:  # at run time inside the functions: reading a finished run needs no PyTorch
    from ssm_pipeline.baselines.s3m.epochs import S3MCheckpoint

LOSSES_FILE = "losses.csv"
KEPT_EPOCHS = (1, 3, 10, 30)  # their networks are kept, so that they can be scored later


def s3m_settings(method: Method, published: S3MSettings) -> S3MSettings:
    """The settings of a row of S3M: those that were published, or tuned ones."""
    return published.tuned() if _is_tuned(method) else published


def s3m_shapes(
    inputs: ComparisonInputs,
    method: Method,
    template: Mesh,
    folder: Path,
    seen: Collection[str] | None = None,
) -> CorrespondedShapes:
    """The cases in S3M's correspondence, each in its own millimetres, kept in `folder`.

    Args:
        template: All cases are first aligned to it rigidly, as they are for every other method.
            S3M chooses its reference itself.
        folder: Of the networks and of every row of S3M.
        seen: The cases that S3M is trained on and chooses its reference from; None: all.

    Raises:
        CaseError: S3M can't do a case.
    """
    settings = s3m_settings(method, inputs.settings.comparison.s3m)
    row = "tuned" if _is_tuned(method) else "shapes"
    meshes, seed = inputs.meshes, inputs.seed

    def work(place: Path) -> Row:
        import torch

        from ssm_pipeline.baselines.common_start import meshes_at_common_start
        from ssm_pipeline.baselines.s3m.s3m import match_s3m

        aligned, frames = meshes_at_common_start(template, meshes, seed)
        trained = _trained(inputs, settings, key, aligned, folder, seen)
        with inputs.terminal.steps("S3M, matching", len(meshes)) as steps:
            match = match_s3m(
                aligned,
                trained,
                settings,
                seed,
                torch.device(inputs.device),
                lambda phase, done, of: steps.advance_to(done),
                seen,
                inputs.jobs,
            )
        points = zip(frames, match.points.vertices, strict=True)
        own = np.stack([frame.apply(shape) for frame, shape in points])
        storage.save(dataclasses.replace(match.points, vertices=own), place / "points.npz")
        return {"template_id": match.points.template_id}

    # Only meshes are read: the result stays as it is when our networks are trained again.
    case_ids, mesh_keys = inputs.case_ids, inputs.mesh_keys
    trained_on = [case_id for case_id in case_ids if seen is None or case_id in seen]
    key = training_key(settings, seed, mesh_keys, template.case_id, trained_on)
    depends_on = [key, settings, [mesh_keys[case_id] for case_id in case_ids]]
    network = network_path(folder, key, settings.epochs)
    if not network.exists():  # it was damaged and deleted: train again and match again
        storage.remove(folder / row / CASE_FILE)
    place = keep_result(
        inputs, "in the comparison", CaseTask(row, key_of(depends_on), work), folder
    )
    if not (folder / LOSSES_FILE).exists():  # it was damaged and deleted
        _write_losses(_read(network), folder)
    return storage.load(CorrespondedShapes, place / "points.npz")


def training_key(
    settings: S3MSettings,
    seed: int,
    mesh_keys: Mapping[str, str],
    template_id: str,
    case_ids: Sequence[str],
) -> str:
    """The key of what a network depends on, which is neither the filter nor later epochs."""
    later = {"kernel_variance_mm2", "kernel_std_share", "epochs"}
    cases = [mesh_keys[case_id] for case_id in case_ids]
    return key_of(settings.model_dump(exclude=later), seed, mesh_keys[template_id], cases)


def network_path(folder: Path, key: str, epoch: int | str) -> Path:
    return folder / f"network-{key}-{epoch}.pt"


def _is_tuned(method: Method) -> bool:
    return method.id != method.base


def _trained(
    inputs: ComparisonInputs,
    settings: S3MSettings,
    key: str,
    meshes: Sequence[Mesh],
    folder: Path,
    seen: Collection[str] | None,
) -> S3MCheckpoint:
    """The network after `settings.epochs`: from its file, or trained on from the last epoch."""
    import torch

    from ssm_pipeline.baselines.s3m.s3m import train_s3m
    from ssm_pipeline.training.tensor_files import save_tensors

    def path(epoch: int | str) -> Path:
        return network_path(folder, key, epoch)

    if path(settings.epochs).exists():
        kept = _read(path(settings.epochs))
        _write_losses(kept, folder)  # they are written after the network, and may be incomplete
        return kept
    found = {int(p.stem.rpartition("-")[2]): p for p in folder.glob(path("*").name)}
    before = max((epoch for epoch in found if epoch < settings.epochs), default=None)
    start = None if before is None else _read(found[before])
    if start is not None:
        inputs.terminal.detail(f"S3M continues after epoch {start.epoch}")
    with inputs.terminal.steps("S3M, epochs of training", settings.epochs) as steps:

        def on_epoch(checkpoint: S3MCheckpoint) -> None:
            epoch = checkpoint.epoch
            save_tensors(dict(checkpoint.__dict__), path(epoch))
            if epoch - 1 not in KEPT_EPOCHS:  # the last one is kept, and those to be scored
                path(epoch - 1).unlink(missing_ok=True)
            _write_losses(checkpoint, folder)
            steps.advance_to(epoch, f"loss {checkpoint.losses[-1]:.3g}")

        return train_s3m(
            [mesh for mesh in meshes if seen is None or mesh.case_id in seen],
            settings,
            inputs.seed,
            torch.device(inputs.device),
            lambda phase, done, of: None,
            start,
            on_epoch,
        )


def _write_losses(checkpoint: S3MCheckpoint, folder: Path) -> None:
    losses = pd.DataFrame({"epoch": range(1, checkpoint.epoch + 1), "loss": checkpoint.losses})
    storage.write_table(losses, folder / LOSSES_FILE)


def _read(network: Path) -> S3MCheckpoint:
    from ssm_pipeline.baselines.s3m.epochs import S3MCheckpoint
    from ssm_pipeline.training.tensor_files import load_tensors

    return S3MCheckpoint(**load_tensors(network))

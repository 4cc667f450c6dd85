"""Training that leaves checkpoints, and goes on from the last one when it was stopped."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.engine.keys import key_of, key_of_files
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.records import DamagedFile, SpectralBasis
from ssm_pipeline.runs.context import Context, training_bases
from ssm_pipeline.runs.layout import LOSSES
from ssm_pipeline.training.settings import TrainingSettings

if TYPE_CHECKING:  # at run time inside the functions: reading a finished run needs no PyTorch
    from ssm_pipeline.training.matcher import Matcher


@dataclass(frozen=True)
class TrainingJob:
    """One training: how, where its files lie, and where it tells of itself.

    Attributes:
        key: Of all that it depends on: a checkpoint of other settings or other cases is never taken
            up.
        label: Its name on the terminal.
    """

    settings: TrainingSettings
    seed: int
    device: str
    folder: Path
    key: str
    label: str
    terminal: Terminal

    @property
    def checkpoint(self) -> Path:
        return self.folder / f"checkpoint-{self.key}.pt"

    @property
    def matcher(self) -> Path:
        return self.folder / f"matcher-{self.key}.pt"


def train_resumably(
    bases: Sequence[SpectralBasis], job: TrainingJob
) -> tuple[Matcher, list[dict[str, float]]]:
    """The trained matcher and its losses, a row per step.

    Other jobs' checkpoints in the folder are removed. The caller saves the matcher and then
    removes `job.checkpoint`.
    """
    from ssm_pipeline.training.checkpoint import load_checkpoint, save_checkpoint
    from ssm_pipeline.training.train import train_networks

    path, label, terminal = job.checkpoint, job.label, job.terminal
    for stale in set(job.folder.glob("checkpoint-*.pt")) - {path}:
        stale.unlink()
    try:
        start = load_checkpoint(path) if path.exists() else None
    except DamagedFile as error:
        terminal.detail(f"{path} {error.found}: {label} starts afresh")
        storage.remove(path)
        start = None
    if start is not None:
        terminal.detail(f"{label} goes on after step {start.step}")
    history = list(start.history) if start else []
    with terminal.steps(label, job.settings.steps) as steps:

        def on_step(step: int, losses: dict[str, float]) -> None:
            history.append(losses)
            steps.advance_to(step, f"loss {losses['total']:.3g}")

        matcher = train_networks(
            bases,
            job.settings,
            job.seed,
            device=job.device,
            start=start,
            on_checkpoint=lambda checkpoint: save_checkpoint(checkpoint, path),
            on_step=on_step,
        )
    return matcher, history


def key_of_start(settings: TrainingSettings) -> str:
    """Hash of the weights that training starts from; empty for fresh ones."""
    path = settings.start_file
    return key_of_files([path]) if path is not None and path.is_file() else ""


def trained_matcher(load_bases: Callable[[], Sequence[SpectralBasis]], job: TrainingJob) -> Path:
    """matcher-<key>.pt in the job's folder: if it is there, nothing is read nor done."""

    if not job.matcher.exists():
        matcher, history = train_resumably(load_bases(), job)
        losses = pd.DataFrame(history)
        losses.insert(0, "step", range(1, len(losses) + 1))
        storage.write_table(losses, job.folder / LOSSES.name)
        matcher.save(job.matcher)
        storage.remove(job.checkpoint)
    return job.matcher


@dataclass(frozen=True)
class TrainingWork:
    """What a stage needs in order to train on some of its cases and keep the result.

    Attributes:
        load_bases: Cases → the bases that are trained on.
        basis_keys: Case → the key of its basis.
    """

    load_bases: Callable[[Sequence[str]], list[SpectralBasis]]
    basis_keys: Mapping[str, str]
    seed: int
    device: str
    terminal: Terminal

    @staticmethod
    def of(context: Context) -> TrainingWork:
        return TrainingWork(
            partial(training_bases, context),
            context.done["spectral"].case_keys,
            context.seed,
            context.device,
            context.terminal,
        )


def matcher_of_cases(
    work: TrainingWork,
    case_ids: Sequence[str],
    settings: TrainingSettings,
    folder: Path,
    label: str,
) -> Path:
    """`trained_matcher` of these cases of a run, and of nothing else."""
    depends_on = {case_id: work.basis_keys[case_id] for case_id in case_ids}
    key = key_of(depends_on, settings, key_of_start(settings), work.seed)
    job = TrainingJob(settings, work.seed, work.device, folder, key, label, work.terminal)
    return trained_matcher(lambda: work.load_bases(case_ids), job)

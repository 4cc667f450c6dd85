"""Training that leaves checkpoints, and goes on from the last one when it was stopped."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ssm_pipeline import storage
from ssm_pipeline.engine.keys import key_of, key_of_files
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.records import DamagedFile, SpectralBasis
from ssm_pipeline.runs.context import Context, training_bases
from ssm_pipeline.training.settings import TrainingSettings

if TYPE_CHECKING:  # at run time inside the functions: reading a finished run needs no PyTorch
    from ssm_pipeline.training.matcher import Matcher


@dataclass(frozen=True)
class TrainingJob:
    """One training: how, where its files lie, and where it tells of itself.

    key    of all that it depends on: a checkpoint of other settings or other cases is never taken
           up. label: its name on the terminal.
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
        terminal.say(f"      {path} {error.found}: {label} starts afresh")
        storage.remove(path)
        start = None
    if start is not None:
        terminal.say(f"      {label} goes on after step {start.step}")
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
    from ssm_pipeline.training.matcher import save_matcher

    if not job.matcher.exists():
        matcher, _ = train_resumably(load_bases(), job)
        save_matcher(matcher, job.matcher)
        storage.remove(job.checkpoint)
    return job.matcher


def matcher_of_cases(
    context: Context,
    case_ids: Sequence[str],
    settings: TrainingSettings,
    folder: Path,
    label: str,
) -> Path:
    """`trained_matcher` of these cases of a run, and of nothing else."""
    spectral_keys = context.done["spectral"].case_keys
    rests_on = {case_id: spectral_keys[case_id] for case_id in case_ids}
    key = key_of(rests_on, settings, key_of_start(settings), context.seed)
    job = TrainingJob(settings, context.seed, context.device, folder, key, label, context.terminal)
    return trained_matcher(lambda: training_bases(context, case_ids), job)

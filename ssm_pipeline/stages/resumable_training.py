"""Training that leaves checkpoints, and goes on from the last one when it was stopped."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ssm_pipeline import storage
from ssm_pipeline.engine.keys import key_of, key_of_files
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.records import DamagedFile, SpectralBasis
from ssm_pipeline.stages.context import Context, training_bases
from ssm_pipeline.training.settings import TrainingSettings

if TYPE_CHECKING:  # at run time inside the functions: reading a finished run needs no PyTorch
    from ssm_pipeline.training.matcher import Matcher


def train_resumably(
    bases: Sequence[SpectralBasis],
    settings: TrainingSettings,
    seed: int,
    device: str,
    folder: Path,
    key: str,
    label: str,
    terminal: Terminal,
) -> tuple[Matcher, list[dict[str, float]]]:
    """The trained matcher and its losses, a row a step.

    The checkpoint lies in `folder` under the key of all that training depends on: one of other
    settings or other cases is never taken up, and is removed. The caller saves the matcher and
    then calls `forget_checkpoint`.
    """
    from ssm_pipeline.training.checkpoint import load_checkpoint, save_checkpoint
    from ssm_pipeline.training.train import train

    path = _checkpoint(folder, key)
    for stale in set(folder.glob(_checkpoint(folder, "*").name)) - {path}:
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
    with terminal.steps(label, settings.steps) as steps:

        def on_step(step: int, losses: dict[str, float]) -> None:
            history.append(losses)
            steps.advance_to(step, f"loss {losses['total']:.3g}")

        matcher = train(
            bases,
            settings,
            seed,
            device=device,
            start=start,
            on_checkpoint=lambda checkpoint: save_checkpoint(checkpoint, path),
            on_step=on_step,
        )
    return matcher, history


def key_of_start(settings: TrainingSettings) -> str:
    """Hash of the weights that training starts from; empty for fresh ones."""
    path = settings.start_file
    return key_of_files([path]) if path is not None and path.is_file() else ""


def forget_checkpoint(folder: Path, key: str) -> None:
    storage.remove(_checkpoint(folder, key))


def trained_matcher(
    load_bases: Callable[[], Sequence[SpectralBasis]],
    settings: TrainingSettings,
    seed: int,
    device: str,
    folder: Path,
    key: str,
    label: str,
    terminal: Terminal,
) -> Path:
    """matcher-<key>.pt in `folder`: if it is there, nothing is read nor done."""
    from ssm_pipeline.training.matcher import save_matcher

    path = folder / f"matcher-{key}.pt"
    if not path.exists():
        matcher, _ = train_resumably(
            load_bases(), settings, seed, device, folder, key, label, terminal
        )
        save_matcher(matcher, path)
        forget_checkpoint(folder, key)
    return path


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
    return trained_matcher(
        lambda: training_bases(context, case_ids),
        settings,
        context.seed,
        context.device,
        folder,
        key_of(rests_on, settings, key_of_start(settings), context.seed),
        label,
        context.terminal,
    )


def _checkpoint(folder: Path, key: str) -> Path:
    return folder / f"checkpoint-{key}.pt"

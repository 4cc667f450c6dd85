"""The state of an unfinished training, enough to continue it to the same bits."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ssm_pipeline.records import DamagedFile
from ssm_pipeline.training.tensor_files import load_tensors, save_tensors


@dataclass(frozen=True)
class TrainingCheckpoint:
    """The state after an optimiser step.

    Attributes:
        step: The number of steps done.
        networks: The weights of both networks, as torch gives them.
        optimiser: The state of the optimiser, as torch gives it.
        history: The losses by name, a row for each step.
        seen_before: The shapes that the starting weights were trained on.
    """

    step: int
    networks: dict[str, Any]
    optimiser: dict[str, Any]
    history: list[dict[str, float]]
    seen_before: tuple[str, ...] = ()


def save_checkpoint(checkpoint: TrainingCheckpoint, path: Path) -> None:
    """Write a checkpoint; the file is complete or absent."""
    save_tensors(dict(checkpoint.__dict__), path)


def load_checkpoint(path: Path) -> TrainingCheckpoint:
    """Read what `save_checkpoint` wrote.

    Raises:
        DamagedFile: For a file that does not hold a complete checkpoint.
    """
    try:
        return TrainingCheckpoint(**load_tensors(path))
    except TypeError as error:
        raise DamagedFile(path, f"holds no checkpoint of this version ({error})") from error

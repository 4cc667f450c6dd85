"""Where training stands, enough to go on to the same bits."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ssm_pipeline.records import DamagedFile
from ssm_pipeline.training.matcher import load_tensors, save_tensors


@dataclass(frozen=True)
class TrainingCheckpoint:
    """step: how many are done; the states as torch gives them; history: a row of losses a step."""

    step: int
    networks: dict[str, Any]
    optimiser: dict[str, Any]
    history: list[dict[str, float]]


def save_checkpoint(checkpoint: TrainingCheckpoint, path: Path) -> None:
    save_tensors(dict(checkpoint.__dict__), path)


def load_checkpoint(path: Path) -> TrainingCheckpoint:
    """Raises DamagedFile for a file that holds no whole checkpoint."""
    try:
        return TrainingCheckpoint(**load_tensors(path))
    except TypeError as error:
        raise DamagedFile(path, f"holds no checkpoint of this version ({error})") from error

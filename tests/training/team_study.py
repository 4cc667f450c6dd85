"""A training that `torchrun` starts: `team_study.py FOLDER [pairs_per_step=N] [dies]`."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

from shapes import basis_of, blob

from ssm_pipeline.interpolation.settings import InterpolationSettings
from ssm_pipeline.matching.settings import MatchingSettings
from ssm_pipeline.training.checkpoint import save_checkpoint
from ssm_pipeline.training.settings import TrainingSettings
from ssm_pipeline.training.team import team_of_torchrun
from ssm_pipeline.training.tensor_files import save_tensors
from ssm_pipeline.training.train import follow, train_networks

SETTINGS = TrainingSettings(
    steps=8,
    pairs_per_step=2,
    time_steps=(1, 2),
    time_step_shares=(0.5, 0.5),
    checkpoint_every=3,
    matching=MatchingSettings(
        features="wks", descriptors=16, channels=16, width=16, blocks=1, dropout=0.2
    ),
    interpolation=InterpolationSettings(width=16, blocks=1),
)


def main(folder: Path, *words: str) -> None:
    numbers = {word.split("=")[0]: int(word.split("=")[1]) for word in words if "=" in word}
    settings = SETTINGS.model_copy(update=numbers)
    with team_of_torchrun() as team:
        if not team.leads:
            if "dies" in words:
                _die_after_a_while(folder / "checkpoint-3.pt")
            follow(team)
            return
        rows: list[dict[str, float]] = []
        matcher = train_networks(
            [basis_of(blob(seed, faces=300)) for seed in (1, 2, 3)],
            settings,
            seed=5,
            on_checkpoint=lambda c: save_checkpoint(c, folder / f"checkpoint-{c.step}.pt"),
            on_step=lambda step, losses: rows.append(losses),
        )
        save_tensors({"losses": rows}, folder / "losses.pt")
        matcher.save(folder / "matcher.pt")
        with (folder / "wrote").open("a") as file:
            file.write(str(team.rank))


def _die_after_a_while(checkpoint: Path) -> None:
    """Once the leader has written this: in the midst of the training."""
    import threading
    import time

    def watch() -> None:
        while not checkpoint.exists():
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGKILL)

    threading.Thread(target=watch, daemon=True).start()


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])

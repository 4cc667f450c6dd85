"""Two processes (gloo) that train together, against the same pairs one after another in one."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from shapes import basis_of, blob

from ssm_pipeline.records import StudyError
from ssm_pipeline.training.checkpoint import load_checkpoint
from ssm_pipeline.training.matcher import load_matcher
from ssm_pipeline.training.team import Team
from ssm_pipeline.training.tensor_files import load_tensors
from ssm_pipeline.training.train import train_networks

HERE = Path(__file__).parent
PATHS = os.pathsep.join(map(str, (HERE, HERE.parent, HERE.parents[1])))


def trained(folder: Path, processes: int, *words: str) -> subprocess.CompletedProcess[str]:
    """`team_study.py` by `torchrun`, in as many processes."""
    script = [str(HERE / "team_study.py"), str(folder), *words]
    return subprocess.run(
        [sys.executable, "-m", "torch.distributed.run", "--standalone",
         "--nproc-per-node", str(processes), *script],
        env={**os.environ, "PYTHONPATH": PATHS, "OMP_NUM_THREADS": "1"},
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip


def weights(path: Path) -> torch.Tensor:
    return torch.cat([p.flatten() for p in load_matcher(path).networks.parameters()])


def test_two_processes_train_as_one_and_go_on_where_the_other_number_stopped(
    tmp_path: Path,
) -> None:
    from team_study import SETTINGS

    losses: list[dict[str, float]] = []
    bases = [basis_of(blob(seed, faces=300)) for seed in (1, 2, 3)]
    alone = train_networks(bases, SETTINGS, seed=5, on_step=lambda step, row: losses.append(row))
    done = trained(tmp_path, 2)
    assert done.returncode == 0, done.stderr[-3000:]
    assert (tmp_path / "wrote").read_text() == "0"  # the leader, and nobody else
    together = load_tensors(tmp_path / "losses.pt")["losses"]
    assert [row.keys() for row in together] == [row.keys() for row in losses]
    for ours, theirs in zip(losses, together, strict=True):
        # Sums in another order: the last bits of float32, which grow from step to step.
        assert theirs == pytest.approx(ours, rel=1e-3, abs=1e-5)
    assert together[0] == pytest.approx(losses[0], rel=1e-6)
    theirs_to_ours = (weights(tmp_path / "matcher.pt") - torch.cat(
        [p.flatten().detach() for p in alone.networks.parameters()])).abs().max()  # fmt: skip
    assert theirs_to_ours < 1e-4

    start = load_checkpoint(tmp_path / "checkpoint-3.pt")  # of two processes, goes on in one
    rest: list[dict[str, float]] = []
    train_networks(bases, SETTINGS, seed=5, start=start, on_step=lambda step, row: rest.append(row))
    assert [row["total"] for row in rest] == pytest.approx(
        [row["total"] for row in losses[3:]], rel=1e-3
    )


def test_three_pairs_on_two_processes_are_no_other_step(tmp_path: Path) -> None:
    from team_study import SETTINGS

    settings = SETTINGS.model_copy(update={"pairs_per_step": 3})
    losses: list[float] = []
    bases = [basis_of(blob(seed, faces=300)) for seed in (1, 2, 3)]
    train_networks(bases, settings, seed=5, on_step=lambda step, row: losses.append(row["total"]))
    done = trained(tmp_path, 2, "pairs_per_step=3")
    assert done.returncode == 0, done.stderr[-3000:]
    together = [row["total"] for row in load_tensors(tmp_path / "losses.pt")["losses"]]
    assert together == pytest.approx(losses, rel=1e-3)


def test_a_process_that_dies_ends_the_others_with_what_to_do(tmp_path: Path) -> None:
    done = trained(tmp_path, 2, "dies")
    assert done.returncode != 0
    assert "a process that trains with this one has ended" in done.stderr
    assert load_checkpoint(tmp_path / "checkpoint-3.pt").step == 3


def test_more_processes_than_pairs_are_refused() -> None:
    with pytest.raises(StudyError, match=r"2 processes .* Set training\.pairs_per_step=2"):
        Team(0, 2).refuse_idle(1)
    Team(0, 2).refuse_idle(2)
    assert [list(Team(rank, 2).share(5)) for rank in (0, 1)] == [[0, 2, 4], [1, 3]]


def test_gradients_of_several_pairs_are_their_mean() -> None:
    """A step of three pairs of one shape with itself is a step of one."""
    from team_study import SETTINGS

    ball = basis_of(blob(1, faces=300))
    rows: dict[int, list[float]] = {1: [], 3: []}
    for pairs in rows:
        still = SETTINGS.matching.model_copy(update={"dropout": 0.0})
        settings = SETTINGS.model_copy(update={"pairs_per_step": pairs, "matching": still})

        def keep(step: int, losses: dict[str, float], pairs: int = pairs) -> None:
            rows[pairs].append(losses["total"])

        train_networks([ball, ball], settings, seed=5, on_step=keep)
    assert rows[1][0] == pytest.approx(rows[3][0], rel=1e-6)
    assert rows[1] == pytest.approx(rows[3], rel=1e-3)  # rounding grows from step to step

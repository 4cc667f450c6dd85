"""Processes that train together, each on its share of a step's pairs.

    torchrun --nproc-per-node 2 -m ssm_pipeline run luna16 --set training.pairs_per_step=2

The first process leads: it does all other work and writes the files. The others follow: they wait
for a training and compute their share of each step. Gradients are added up on the CPU (gloo) for
every device, because the networks have few weights and a step takes a hundred times as long. A
process without a team trains by itself. PyTorch is imported inside the functions, because every run
looks for its team, also a run that trains no network.
"""

from __future__ import annotations

import datetime
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ssm_pipeline.records import StudyError

if TYPE_CHECKING:
    import torch

WAIT = datetime.timedelta(days=30)  # a leader may do other work for long; its end is noticed


@dataclass(frozen=True)
class Team:
    """This process's place among those that train together: rank 0 leads."""

    rank: int = 0
    size: int = 1

    @staticmethod
    def here() -> Team:
        """The team that `team_of_torchrun` joined. Without one: a team of this process only."""
        import torch.distributed as dist

        if not (dist.is_available() and dist.is_initialized()):
            return Team()
        return Team(dist.get_rank(), dist.get_world_size())

    @property
    def leads(self) -> bool:
        return self.rank == 0

    def share(self, count: int) -> range:
        """Which of `count` pairs are this process's."""
        return range(self.rank, count, self.size)

    def refuse_idle(self, pairs_per_step: int) -> None:
        """Raise StudyError where there are more processes than pairs in a step."""
        if self.size > pairs_per_step:
            raise StudyError(
                f"{self.size} processes train together, and training.pairs_per_step is "
                f"{pairs_per_step}: each needs a pair of its own. Set "
                f"training.pairs_per_step={self.size}, or a multiple of it."
            )

    def call(self, work: Mapping[str, Any] | None) -> None:
        """Send the followers the arguments of a training. None: there are no more."""
        if self.size > 1 and self.leads:
            import torch.distributed as dist

            dist.broadcast_object_list([work])

    def await_call(self) -> Any:
        """Wait in a follower for the arguments of the next training."""
        import torch.distributed as dist

        received: list[Any] = [None]
        with _lost_process_reported():
            dist.broadcast_object_list(received)
        return received[0]

    def add_up(self, tensors: Sequence[torch.Tensor]) -> None:
        """Replace each tensor by its sum over all processes, in place."""
        if self.size == 1:
            return
        import torch
        import torch.distributed as dist

        flat = torch.cat([tensor.detach().flatten().cpu() for tensor in tensors])
        with _lost_process_reported():
            dist.all_reduce(flat)
        parts = flat.split([tensor.numel() for tensor in tensors])
        for tensor, part in zip(tensors, parts, strict=True):
            tensor.copy_(part.view_as(tensor))


@contextmanager
def team_of_torchrun() -> Iterator[Team]:
    """Join the processes that `torchrun` started. Otherwise: a team of this process."""
    if "TORCHELASTIC_RUN_ID" not in os.environ or os.environ["WORLD_SIZE"] == "1":
        yield Team()
        return
    import torch.distributed as dist

    dist.init_process_group("gloo", timeout=WAIT)
    team, ended_well = Team.here(), False
    try:
        yield team
        ended_well = True
    finally:
        with suppress(RuntimeError):  # the others are gone already
            team.call(None)
            if ended_well:  # who closes the line while another still reads aborts it
                dist.barrier()
        dist.destroy_process_group()


@contextmanager
def _lost_process_reported() -> Iterator[None]:
    try:
        yield
    except RuntimeError as error:
        raise StudyError(
            "a process that trains with this one has ended; its message says why. Run the same "
            "command again, with any number of processes: it goes on from the last checkpoint. "
            f"({str(error).strip().splitlines()[0]})"
        ) from error

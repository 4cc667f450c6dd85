"""Pairs of a cohort → a trained matcher."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ssm_pipeline.matching.map_health import map_health
from ssm_pipeline.matching.pair import MatchedPair
from ssm_pipeline.matching.shape import COORDINATE_SCALE, Shape, to_shape
from ssm_pipeline.records import SpectralBasis, StudyError
from ssm_pipeline.training.checkpoint import TrainingCheckpoint
from ssm_pipeline.training.loss import pair_loss
from ssm_pipeline.training.matcher import Matcher
from ssm_pipeline.training.networks import Networks
from ssm_pipeline.training.pairs import Pairs
from ssm_pipeline.training.settings import TrainingSettings
from ssm_pipeline.training.start import starting_weights
from ssm_pipeline.training.team import Team


def train_networks(
    bases: Sequence[SpectralBasis],
    settings: TrainingSettings,
    seed: int,
    device: str = "cpu",
    start: TrainingCheckpoint | None = None,
    families: Sequence[str] | None = None,
    on_checkpoint: Callable[[TrainingCheckpoint], None] = lambda checkpoint: None,
    on_step: Callable[[int, dict[str, float]], None] = lambda step, losses: None,
) -> Matcher:
    """Train on all unordered pairs, `pairs_per_step` per step, in an order that the seed decides.

    In a team (`training.team`) every process computes a share of each step's pairs. The leader
    calls this function, and the followers are in `follow`.

    Args:
        bases: The shapes, all with the same number of eigenpairs.
        settings: Networks, losses and schedule.
        seed: Decides the first weights and the order of the pairs.
        device: Where to train: "cpu" or "cuda".
        start: Training continues from it, to the same bits as a training that was never stopped.
        families: The family of each shape. A pair consists of two shapes of one family. None: all
            shapes are of one family.
        on_checkpoint: Receives a checkpoint every `checkpoint_every` steps.
        on_step: Receives the number of steps done and the losses, means over the step's pairs;
            every `watch_every` steps also map_extent, map_sharpness, mean_cosine and share_hit of
            the first pair (`MapHealth`).

    Returns:
        The trained matcher.

    Raises:
        StudyError: For fewer than two shapes of a family, for shapes with different numbers of
            eigenpairs, for a loss that is not finite, and for starting weights that do not fit.
    """
    team = Team.here()
    team.refuse_idle(settings.pairs_per_step)
    pairs = Pairs(families or [""] * len(bases), seed)
    if not len(pairs):
        raise StudyError(f"training needs at least 2 shapes; {len(bases)} found")
    refuse_unlike_eigenpairs(bases)
    team.call({"bases": bases, "settings": settings, "seed": seed, "start": start,
               "families": families, "device": torch.device(device).type})  # fmt: skip
    shapes = [to_shape(basis, settings.matching, device) for basis in bases]
    networks = Networks.new(settings, seed, device)
    optimiser = torch.optim.Adam(networks.parameters(), lr=settings.learning_rate)
    history: list[dict[str, float]] = []
    seen_before: tuple[str, ...] = ()
    if start is not None:
        networks.load(start.networks)
        optimiser.load_state_dict(start.optimiser)
        history, seen_before = list(start.history), tuple(start.seen_before)
    elif (weights := starting_weights(settings, bases, device)) is not None:
        networks.load(weights.networks.state())
        seen_before = weights.trained_on

    while (place := next_place(history, settings)) < settings.steps:
        step = len(history)
        first = step * settings.pairs_per_step
        for group in optimiser.param_groups:
            group["lr"] = learning_rate_at(place, settings)
        optimiser.zero_grad(set_to_none=True)
        share = team.share(settings.pairs_per_step)
        intervals = settings.intervals_at(place)
        found = _gradients(share, pairs, first, shapes, networks, intervals, settings)
        team.add_up([found.losses, *(p.grad for p in networks.parameters() if p.grad is not None)])
        if not clip_gradients(networks, settings):
            not_finite = ~torch.isfinite(found.losses[:, 0])
            x, y = pairs.at(first + int(not_finite.int().argmax()))
            raise StudyError(
                f"the loss of {bases[x].case_id} and {bases[y].case_id} is not finite at step "
                f"{step}; look at these two meshes, or lower training.learning_rate"
            )
        optimiser.step()
        losses = {"schedule": float(place)} | found.means()
        if found.first is not None and (
            step % settings.watch_every == 0 or place == settings.steps - 1
        ):
            losses |= _watched(found.first)
        history.append(losses)
        on_step(step + 1, losses)
        if (step + 1) % settings.checkpoint_every == 0:
            state = networks.state(), optimiser.state_dict(), history, seen_before
            on_checkpoint(TrainingCheckpoint(step + 1, *state))
    seen = dict.fromkeys([*seen_before, *(basis.case_id for basis in bases)])
    return Matcher(networks.eval(), settings, seed, tuple(seen), len(bases[0].eigenvalues))


def refuse_unlike_eigenpairs(bases: Sequence[SpectralBasis]) -> None:
    """Raise StudyError for shapes with different numbers of eigenpairs: the inputs depend on it."""
    counts = {basis.case_id: len(basis.eigenvalues) for basis in bases}
    first, count = next(iter(counts.items()))
    for case_id, other in counts.items():
        if other != count:
            raise StudyError(
                f"{first} has {count} eigenpairs and {case_id} has {other}; shapes trained on "
                "together need the same number. Compute the bases with one SpectralSettings."
            )


@dataclass(frozen=True, eq=False)
class _Found:
    """The losses of a step's pairs, a row each, zero where another process has the pair; the first
    pair as matched, where it is this process's."""

    names: tuple[str, ...]
    losses: torch.Tensor
    first: MatchedPair | None

    def means(self) -> dict[str, float]:
        return dict(zip(self.names, self.losses.mean(dim=0).tolist(), strict=True))


def _gradients(
    share: range,
    pairs: Pairs,
    first: int,
    shapes: Sequence[Shape],
    networks: Networks,
    intervals: int,
    settings: TrainingSettings,
) -> _Found:
    """Add up in the parameters' `grad` what a share of a step's pairs has in their mean loss."""
    rows: dict[int, torch.Tensor] = {}
    matched: MatchedPair | None = None
    names: tuple[str, ...] = ("total",)
    device = shapes[0].vertices.device
    for number in share:
        x, y = pairs.at(first + number)
        with torch.random.fork_rng(devices=[] if device.type == "cpu" else [device]):
            # Dropout's draws, and the turns: of the seed and the pair's place, so that a resumed
            # run has them, and any number of processes.
            torch.manual_seed(hash_of(pairs.seed, first + number))
            shape_x, shape_y = turned_inputs(shapes[x], shapes[y], settings)
            total, terms, pair = pair_loss(shape_x, shape_y, networks, intervals, settings)
        (total / settings.pairs_per_step).backward()
        rows[number] = torch.stack([total, *terms.values()]).detach().cpu()
        names = ("total", *terms)
        matched = pair if number == 0 else matched
    losses = torch.zeros(settings.pairs_per_step, len(names))
    for number, row in rows.items():
        losses[number] = row
    return _Found(names, losses, matched)


def follow(team: Team) -> None:
    """Take part in every training that the leader calls for, until it has no more."""
    while (work := team.await_call()) is not None:
        if work["device"] == "cuda":  # of a machine's processes each has a GPU of its own
            work["device"] = f"cuda:{os.environ['LOCAL_RANK']}"
        train_networks(**work)


def next_place(history: Sequence[dict[str, float]], settings: TrainingSettings) -> int:
    """The step of the schedule that comes next: the one after the last, or the next T's first where
    the loss has stopped falling (`settings.patience`)."""
    if not history:
        return 0
    last = int(history[-1].get("schedule", len(history) - 1))
    if settings.patience == 0 or len(history) < 2 * settings.patience:
        return last + 1
    recent = history[-2 * settings.patience :]
    begun = int(recent[0].get("schedule", 0))
    if settings.next_phase(begun) != settings.next_phase(last):
        return last + 1
    before, after = np.array([row["total"] for row in recent]).reshape(2, -1).mean(axis=1)
    return last + 1 if after < 0.99 * before else settings.next_phase(last)


def turned_inputs(x: Shape, y: Shape, settings: TrainingSettings) -> tuple[Shape, Shape]:
    """Both shapes with their input coordinates turned and shifted at random; operators stay."""
    still = settings.turn_deg == 0 and settings.jitter == 0 and not settings.turn_together
    if settings.matching.features != "xyz+wks" or still:
        return x, y
    together = _random_turn(180.0) if settings.turn_together else torch.eye(3)
    return _turned(x, together, settings), _turned(y, together, settings)


def _turned(shape: Shape, together: torch.Tensor, settings: TrainingSettings) -> Shape:
    rotation = (_random_turn(settings.turn_deg) @ together).to(shape.inputs)
    shift = (COORDINATE_SCALE * settings.jitter * torch.randn(3)).to(shape.inputs)
    inputs = torch.cat([shape.inputs[:, :3] @ rotation.T + shift, shape.inputs[:, 3:]], dim=1)
    return dataclasses.replace(shape, inputs=inputs)


def _random_turn(largest_deg: float) -> torch.Tensor:
    """(3, 3): about an axis of any direction, by an angle drawn evenly up to the largest."""
    axis = torch.nn.functional.normalize(torch.randn(3), dim=0)
    angle = math.radians(largest_deg) * torch.rand(1)
    cross = torch.zeros(3, 3)
    cross[[2, 0, 1], [1, 2, 0]], cross[[1, 2, 0], [2, 0, 1]] = axis, -axis
    result: torch.Tensor = torch.linalg.matrix_exp(angle * cross)
    return result


def hash_of(seed: int, step: int) -> int:
    """One number of both, for torch's generator."""
    return int(np.random.default_rng([seed, step]).integers(2**63 - 1))


def clip_gradients(networks: Networks, settings: TrainingSettings) -> bool:
    """Limit the gradient's norm; False where it is not finite."""
    parts = networks.both() if settings.clip_each_network else (networks,)
    norms = [
        torch.nn.utils.clip_grad_norm_(part.parameters(), settings.gradient_clip) for part in parts
    ]
    return all(bool(torch.isfinite(norm)) for norm in norms)


def _watched(pair: MatchedPair) -> dict[str, float]:
    health = map_health(
        pair.shape_x,
        pair.shape_y,
        pair.features_x,
        pair.features_y,
        pair.settings.temperature,
    )
    return {
        "map_extent": health.extent,
        "map_sharpness": health.sharpness,
        "mean_cosine": health.mean_cosine,
        "share_hit": health.share_hit,
    }


def learning_rate_at(step: int, settings: TrainingSettings) -> float:
    """Cosine from the first to the final learning rate."""
    share = 0.5 * (1 + math.cos(math.pi * step / settings.steps))
    final = settings.final_learning_rate
    return final + (settings.learning_rate - final) * share

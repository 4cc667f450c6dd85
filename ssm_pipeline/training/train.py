"""Pairs of a cohort → a trained matcher."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np
import torch

from ssm_pipeline.matching.shape import to_shape
from ssm_pipeline.records import SpectralBasis, StudyError
from ssm_pipeline.training.checkpoint import Checkpoint
from ssm_pipeline.training.loss import pair_loss
from ssm_pipeline.training.matcher import Matcher, new_networks
from ssm_pipeline.training.settings import TrainingSettings


def train(
    bases: Sequence[SpectralBasis],
    settings: TrainingSettings,
    seed: int,
    device: str = "cpu",
    start: Checkpoint | None = None,
    on_checkpoint: Callable[[Checkpoint], None] = lambda checkpoint: None,
    on_step: Callable[[int, dict[str, float]], None] = lambda step, losses: None,
) -> Matcher:
    """Train on all unordered pairs, one a step, in an order that the seed and step decide.

    Continues from `start`, to the same bits as a run that was never stopped. Raises StudyError
    for fewer than two shapes or where the loss is no longer finite.
    """
    if len(bases) < 2:
        raise StudyError(f"training needs at least 2 shapes; {len(bases)} found")
    shapes = [to_shape(basis, settings.matching, device) for basis in bases]
    feature_network, interpolator = new_networks(settings, seed)
    feature_network, interpolator = feature_network.to(device), interpolator.to(device)
    parameters = [*feature_network.parameters(), *interpolator.parameters()]
    optimiser = torch.optim.Adam(parameters, lr=settings.learning_rate)
    history: list[dict[str, float]] = []
    if start is not None:
        feature_network.load_state_dict(start.feature_network)
        interpolator.load_state_dict(start.interpolator)
        optimiser.load_state_dict(start.optimiser)
        history = list(start.history)

    for step in range(len(history), settings.steps):
        x, y = pair_at(step, len(shapes), seed)
        for group in optimiser.param_groups:
            group["lr"] = learning_rate_at(step, settings)
        optimiser.zero_grad(set_to_none=True)
        total, terms = pair_loss(
            shapes[x],
            shapes[y],
            feature_network,
            interpolator,
            settings.time_steps_at(step),
            settings,
        )
        total.backward()
        norm = torch.nn.utils.clip_grad_norm_(parameters, settings.gradient_clip)
        if not torch.isfinite(norm):
            raise StudyError(
                f"the loss of {bases[x].case_id} and {bases[y].case_id} is not finite at step "
                f"{step}; look at these two meshes, or lower training.learning_rate"
            )
        optimiser.step()
        losses = {"total": float(total.detach())}
        losses |= {name: float(term.detach()) for name, term in terms.items()}
        history.append(losses)
        on_step(step + 1, losses)
        if (step + 1) % settings.checkpoint_every == 0:
            on_checkpoint(
                Checkpoint(
                    step + 1,
                    feature_network.state_dict(),
                    interpolator.state_dict(),
                    optimiser.state_dict(),
                    history,
                )
            )
    return Matcher(
        feature_network.eval(),
        interpolator.eval(),
        settings,
        seed,
        tuple(basis.case_id for basis in bases),
    )


def pair_at(step: int, count: int, seed: int) -> tuple[int, int]:
    """The pair of a step: every unordered pair once an epoch, each epoch in a new order.

    The loss is symmetric, so the other order of a pair would teach the same again.
    """
    pairs = list(itertools.combinations(range(count), 2))
    epoch, position = divmod(step, len(pairs))
    return pairs[np.random.default_rng([seed, epoch]).permutation(len(pairs))[position]]


def learning_rate_at(step: int, settings: TrainingSettings) -> float:
    """Cosine from the first to the final learning rate."""
    share = 0.5 * (1 + math.cos(math.pi * step / settings.steps))
    final = settings.final_learning_rate
    return final + (settings.learning_rate - final) * share

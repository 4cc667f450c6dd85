"""Training of S3M's network. Each epoch depends only on its number and the seed."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from ssm_pipeline.baselines.s3m.least_squares_map import functional_maps
from ssm_pipeline.baselines.s3m.losses import multiplication_operators, pair_losses
from ssm_pipeline.baselines.s3m.network import FeatureExtractor
from ssm_pipeline.baselines.s3m.samples import Sample, TrainingCopy, drawn_sample, stacked
from ssm_pipeline.baselines.s3m.settings import S3MSettings


@dataclass(frozen=True)
class S3MCheckpoint:
    """After an epoch, enough to go on to the same bits: states as torch gives them, and the mean
    loss of each epoch so far."""

    network: dict[str, Any]
    optimiser: dict[str, Any]
    scheduler: dict[str, Any]
    losses: list[float]

    @property
    def epoch(self) -> int:
        return len(self.losses)


def train_extractor(
    copies: Sequence[TrainingCopy],
    settings: S3MSettings,
    seed: int,
    device: torch.device,
    on_step: Callable[[int, int], None],
    start: S3MCheckpoint | None = None,
    on_epoch: Callable[[S3MCheckpoint], None] = lambda checkpoint: None,
) -> S3MCheckpoint:
    """Train on the copies up to `settings.epochs`; on_epoch gets every epoch's checkpoint.

    Every epoch draws a new sample of each copy (the public code: every use). The learning rate
    follows the training loss (the public code: that of a validation fold); it knows nothing of the
    epochs to come, so the checkpoint of epoch 3 is what a training of 3 epochs ends with.
    """
    network = new_network(settings, seed).to(device)
    optimiser = torch.optim.AdamW(network.parameters(), lr=settings.learning_rate)
    scheduler = torch.optim.lr_scheduler.ReduceLROnPlateau(
        optimiser,
        factor=settings.plateau_factor,
        patience=settings.plateau_patience,
        threshold=settings.plateau_threshold,
    )
    losses: list[float] = []
    if start is not None:
        network.load_state_dict(start.network)
        optimiser.load_state_dict(start.optimiser)
        scheduler.load_state_dict(start.scheduler)
        losses = list(start.losses)
    steps = step_count(len(copies), settings)
    while len(losses) < settings.epochs:
        epoch = len(losses)
        generator = np.random.default_rng([seed, epoch])
        samples = [drawn_sample(shape, settings, generator, device) for shape in copies]
        total = 0.0
        for step, pairs in enumerate(batches(len(copies), settings, generator), start=1):
            loss = batch_loss(network, samples, pairs, settings, generator)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            total += loss.item()
            on_step(epoch * steps + step, settings.epochs * steps)
        losses.append(total / steps)
        scheduler.step(losses[-1])
        on_epoch(_checkpoint(network, optimiser, scheduler, losses))
    return _checkpoint(network, optimiser, scheduler, losses)


def new_network(settings: S3MSettings, seed: int) -> FeatureExtractor:
    return FeatureExtractor(settings.feature_size, torch.Generator().manual_seed(seed))


def step_count(copies: int, settings: S3MSettings) -> int:
    """Optimisation steps an epoch: all ordered pairs of copies, a batch at a time."""
    pairs = settings.copies_per_step**2 if settings.copies_per_step else settings.pairs_per_step
    return math.ceil(copies**2 / pairs)


def batches(copies: int, settings: S3MSettings, generator: np.random.Generator) -> list[np.ndarray]:
    """The pairs of an epoch's steps, each (P, 2): numbers of copies.

    As published, every ordered pair once an epoch, in random order, `pairs_per_step` at a time; or
    as many steps of all ordered pairs of `copies_per_step` copies.
    """
    steps = step_count(copies, settings)
    if settings.copies_per_step is None:
        order = generator.permutation(copies**2)
        pairs = np.stack(np.divmod(order, copies), axis=1)
        return np.split(pairs, np.arange(1, steps) * settings.pairs_per_step)
    drawn = [generator.permutation(copies)[: settings.copies_per_step] for _ in range(steps)]
    return [np.stack(np.meshgrid(d, d, indexing="ij"), axis=-1).reshape(-1, 2) for d in drawn]


def batch_loss(
    network: FeatureExtractor,
    samples: Sequence[Sample],
    pairs: np.ndarray,
    settings: S3MSettings,
    generator: np.random.Generator,
) -> torch.Tensor:
    """Mean loss over the pairs (P, 2) of samples; the network passes once over each sample."""
    used, places = np.unique(pairs, return_inverse=True)
    shapes = [samples[number] for number in used]
    x, y = torch.as_tensor(places.reshape(pairs.shape), device=shapes[0].points.device).T
    F = descriptors(network, shapes)
    coefficients = stacked(shapes, "projection") @ F
    operators = descriptor_operators(F, shapes, random_descriptors(settings, generator))
    values = stacked(shapes, "eigenvalues")
    C = functional_maps(coefficients[x], coefficients[y])
    C_back = functional_maps(coefficients[y], coefficients[x])
    there = pair_losses(C, C_back, values[x], values[y], operators[x], operators[y], settings)
    back = pair_losses(C_back, C, values[y], values[x], operators[y], operators[x], settings)
    return (there + back).mean()


def descriptors(network: FeatureExtractor, samples: Sequence[Sample]) -> torch.Tensor:
    """(B, n, d): the network's features of each sample."""
    return torch.stack([network(sample.points, sample.graph) for sample in samples])


def descriptor_operators(
    F: torch.Tensor, samples: Sequence[Sample], chosen: np.ndarray
) -> torch.Tensor:
    """(B, p, k, k): of the chosen ones of the descriptors (B, n, d)."""
    picked = F[:, :, torch.as_tensor(chosen, device=F.device)]
    return torch.stack(
        [
            multiplication_operators(f, sample.products, len(sample.eigenvalues))
            for f, sample in zip(picked, samples, strict=True)
        ]
    )


def random_descriptors(settings: S3MSettings, generator: np.random.Generator) -> np.ndarray:
    """The numbers of the descriptors that the preservation term looks at in this step."""
    count = max(1, int(settings.feature_size * settings.preservation_share))
    return generator.permutation(settings.feature_size)[:count]


def _checkpoint(
    network: FeatureExtractor,
    optimiser: torch.optim.Optimizer,
    scheduler: torch.optim.lr_scheduler.ReduceLROnPlateau,
    losses: Sequence[float],
) -> S3MCheckpoint:
    """A copy that later steps do not change."""
    weights = {name: value.detach().clone() for name, value in network.state_dict().items()}
    return S3MCheckpoint(
        weights, copy.deepcopy(optimiser.state_dict()), scheduler.state_dict(), list(losses)
    )

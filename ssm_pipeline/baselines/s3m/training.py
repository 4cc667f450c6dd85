"""Training of S3M's feature extractor."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import torch

from ssm_pipeline.baselines.s3m.functional_map import functional_maps
from ssm_pipeline.baselines.s3m.losses import multiplication_operators, pair_losses
from ssm_pipeline.baselines.s3m.network import FeatureExtractor
from ssm_pipeline.baselines.s3m.samples import Sample, stacked
from ssm_pipeline.baselines.s3m.settings import S3MSettings


def descriptors(network: FeatureExtractor, samples: Sequence[Sample]) -> torch.Tensor:
    """(B, n, d): the network's features of each sample."""
    return torch.stack([network(sample.points, sample.graph) for sample in samples])


def random_descriptors(settings: S3MSettings, generator: torch.Generator) -> torch.Tensor:
    """The numbers of the descriptors that the preservation term looks at in this step."""
    count = max(1, int(settings.feature_size * settings.preservation_share))
    return torch.randperm(settings.feature_size, generator=generator)[:count]


def batch_loss(
    network: FeatureExtractor,
    samples: Sequence[Sample],
    settings: S3MSettings,
    generator: torch.Generator,
) -> torch.Tensor:
    """Mean loss over all ordered pairs of the samples."""
    F = descriptors(network, samples)
    Phi, projection = stacked(samples, "eigenvectors"), stacked(samples, "projection")
    coefficients = projection @ F
    C = functional_maps(coefficients[:, None], coefficients[None, :])
    operators = multiplication_operators(
        F[:, :, random_descriptors(settings, generator).to(F.device)], projection, Phi
    )
    values = stacked(samples, "eigenvalues")
    one_way = pair_losses(C, C.transpose(0, 1), values, values, operators, operators, settings)
    return 2 * one_way.mean()  # a pair's loss has both directions; the pairs come in both orders


def step_count(copies: int, settings: S3MSettings) -> int:
    """Optimisation steps an epoch: all ordered pairs of copies, a batch at a time."""
    return math.ceil(copies**2 / settings.shapes_per_step**2)


def train(
    copies: Sequence[Sequence[Sample]],
    settings: S3MSettings,
    generator: torch.Generator,
    device: torch.device,
    on_step: Callable[[int, int], None],
) -> tuple[FeatureExtractor, list[float]]:
    """Train on the copies (each a list of samples of one shape or augmented shape).

    Returns the network and the mean loss of each epoch. A batch is all ordered pairs of
    `shapes_per_step` copies, not 64 pairs drawn one by one: as many pairs and as many steps as
    published, for 8 passes of the network a step instead of up to 128. The learning rate follows
    the training loss (the published code: that of a validation fold).
    """
    network = FeatureExtractor(settings.feature_size, generator).to(device)
    optimiser = torch.optim.AdamW(network.parameters(), lr=settings.learning_rate)
    scheduler = torch.optim.lr_scheduler.ReduceLROnPlateau(
        optimiser,
        factor=settings.plateau_factor,
        patience=settings.plateau_patience,
        threshold=settings.plateau_threshold,
    )
    steps = step_count(len(copies), settings)
    losses = []
    for epoch in range(settings.epochs):
        total = 0.0
        for step in range(steps):
            drawn = torch.randperm(len(copies), generator=generator)[: settings.shapes_per_step]
            samples = [
                copies[copy][int(torch.randint(len(copies[copy]), (), generator=generator))]
                for copy in drawn.tolist()
            ]
            loss = batch_loss(network, samples, settings, generator)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            total += loss.item()
            on_step(epoch * steps + step + 1, settings.epochs * steps)
        losses.append(total / steps)
        scheduler.step(losses[-1])
    return network, losses

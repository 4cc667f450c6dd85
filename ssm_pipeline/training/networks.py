"""The two networks that are trained together."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch
from torch import nn

from ssm_pipeline.interpolation.interpolator import Interpolator
from ssm_pipeline.matching.diffusion_net import FeatureNetwork
from ssm_pipeline.training.settings import TrainingSettings


@dataclass(frozen=True)
class Networks:
    """Feature network and interpolator Ω."""

    features: FeatureNetwork
    interpolator: Interpolator

    @staticmethod
    def new(settings: TrainingSettings, seed: int, device: str = "cpu") -> Networks:
        """Fresh weights, which depend only on the seed."""
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            features = FeatureNetwork(settings.matching)
            interpolator = Interpolator(settings.interpolation)
        return Networks(features.to(device), interpolator.to(device))

    def both(self) -> tuple[nn.Module, nn.Module]:
        return self.features, self.interpolator

    def parameters(self) -> Iterator[nn.Parameter]:
        for network in self.both():
            yield from network.parameters()

    def state(self) -> dict[str, dict[str, Any]]:
        return {
            "features": self.features.state_dict(),
            "interpolator": self.interpolator.state_dict(),
        }

    def load(self, state: dict[str, dict[str, Any]]) -> None:
        self.features.load_state_dict(state["features"])
        self.interpolator.load_state_dict(state["interpolator"])

    def eval(self) -> Networks:
        for network in self.both():
            network.eval()
        return self

"""Settings of training: networks, loss weights, schedule."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Annotated

from pydantic import Field, model_validator

from ssm_pipeline.interpolation.settings import InterpolationSettings, SpatialLossSettings
from ssm_pipeline.matching.settings import MatchingSettings, SpectralLossWeights
from ssm_pipeline.settings import Settings

WEIGHTS = Path(__file__).parent / "weights"
BUILT_IN_EIGENPAIRS = 120  # that the built-in weights were trained with


class TrainingSettings(Settings):
    """Networks, losses and schedule: how a matcher is trained."""

    # built-in: weights trained on synthetic shapes, a file for each kind of network input. none:
    # fresh weights. Or the path of a matcher.pt.
    start: str = "none"
    steps: int = Field(1500, ge=0)  # optimiser steps; 0: the weights as they start
    pairs_per_step: int = Field(1, ge=1)  # their gradients' mean; as many processes can share them
    faces: int = Field(2000, ge=200)  # triangles of the coarser meshes trained on
    learning_rate: float = Field(1e-3, gt=0)  # Adam, at the start
    final_learning_rate: float = Field(1e-4, gt=0)  # reached by a cosine
    gradient_clip: float = Field(1.0, gt=0)  # largest norm of the gradient
    clip_each_network: bool = True  # by itself, as in the authors' code; False: both together
    time_steps: tuple[Annotated[int, Field(ge=1)], ...] = (1, 3, 5, 7)  # T, growing
    time_step_shares: tuple[float, ...] = (0.7, 0.1, 0.1, 0.1)  # of the steps, for each T
    # Plateau: once the mean loss of so many steps is less than 1 % below that of as many before, at
    # the same T, training goes on at the next T, and after the last it ends. 0: all steps are done.
    patience: int = Field(0, ge=0)
    # Augmentation of the coordinates that the network reads, at every step: a random rotation of
    # each shape of up to `turn_deg` degrees and a normal shift; with `turn_together`, before that,
    # one rotation of any angle for both shapes of a pair, so that directions carry no information.
    turn_together: bool = False
    turn_deg: float = Field(0.0, ge=0, le=180)
    jitter: float = Field(0.0, ge=0)  # of √area, standard deviation along each axis
    watch_every: int = Field(25, ge=1)  # steps between looks at the soft map, for the losses' table
    checkpoint_every: int = Field(50, ge=1)  # steps between checkpoints
    template_pairs: int = Field(8, ge=1)  # partners each candidate template is tried on
    matching: MatchingSettings = MatchingSettings()
    interpolation: InterpolationSettings = InterpolationSettings()
    spectral_loss: SpectralLossWeights = SpectralLossWeights()
    spatial_loss: SpatialLossSettings = SpatialLossSettings()

    @model_validator(mode="after")
    def _shares_fit(self) -> TrainingSettings:
        if len(self.time_steps) != len(self.time_step_shares):
            raise ValueError(
                f"{len(self.time_steps)} time_steps but {len(self.time_step_shares)} "
                "time_step_shares; one share for each is needed"
            )
        if abs(sum(self.time_step_shares) - 1) > 1e-6:
            raise ValueError(f"time_step_shares add up to {sum(self.time_step_shares)}, not 1")
        return self

    @model_validator(mode="after")
    def _no_steps_from_nothing(self) -> TrainingSettings:
        if self.steps == 0 and self.start == "none":
            raise ValueError(
                "training.steps is 0 and training.start none: the networks would be random. Ask "
                "for steps, or for training.start=built-in"
            )
        return self

    @property
    def start_file(self) -> Path | None:
        """The file of the weights that training starts from. None: fresh weights."""
        if self.start == "none":
            return None
        if self.start == "built-in":
            return WEIGHTS / f"{self.matching.features.replace('+', '_')}.pt"
        return Path(self.start).expanduser()

    def spectral_only(self) -> TrainingSettings:
        """The same settings without the spatial loss: features trained for matching only."""
        return self.model_copy(update={"spatial_loss": SpatialLossSettings.none()})

    def _phase_ends(self) -> list[int]:
        """The first step after each T's."""
        reached = itertools.accumulate(self.time_step_shares)
        return [math.ceil(share * self.steps - 1e-9) for share in reached]

    def intervals_at(self, step: int) -> int:
        """T at an optimiser step."""
        for T, end in zip(self.time_steps, self._phase_ends(), strict=True):
            if step < end:
                return T
        return self.time_steps[-1]

    def next_phase(self, step: int) -> int:
        """The first step after `step` with another T, or the end."""
        return min([end for end in self._phase_ends() if end > step] + [self.steps])

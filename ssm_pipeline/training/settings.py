"""Settings of training: networks, loss weights, schedule."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from ssm_pipeline.interpolation.settings import InterpolationSettings, SpatialLossSettings
from ssm_pipeline.matching.settings import MatchingSettings, SpectralLossWeights
from ssm_pipeline.settings import Settings


class TrainingSettings(Settings):
    steps: int = Field(1500, ge=1)  # optimiser steps, one pair each
    faces: int = Field(2000, ge=200)  # triangles of the coarser meshes trained on
    learning_rate: float = Field(1e-3, gt=0)  # Adam, at the start
    final_learning_rate: float = Field(1e-4, gt=0)  # reached by a cosine
    gradient_clip: float = Field(1.0, gt=0)  # largest norm of the gradient
    clip_each_network: bool = True  # by itself, as in the authors' code; False: both together
    time_steps: tuple[Annotated[int, Field(ge=1)], ...] = (1, 3, 5, 7)  # T, growing
    time_step_shares: tuple[float, ...] = (0.7, 0.1, 0.1, 0.1)  # of the steps, for each T
    # Each shape's coordinates, where they are network input, are turned by a random rotation of up
    # to so many degrees and shifted by a normal draw, at every step.
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

    def spectral_only(self) -> TrainingSettings:
        """The same without the spatial loss: features trained for matching alone."""
        return self.model_copy(update={"spatial_loss": SpatialLossSettings.none()})

    def intervals_at(self, step: int) -> int:
        """T at an optimiser step."""
        reached = 0.0
        for T, share in zip(self.time_steps, self.time_step_shares, strict=True):
            reached += share
            if step < reached * self.steps - 1e-9:
                return T
        return self.time_steps[-1]

"""Settings of training: networks, loss weights, schedule."""

from __future__ import annotations

from pydantic import Field, model_validator

from ssm_pipeline.interpolation.settings import InterpolationSettings, SpatialLossWeights
from ssm_pipeline.matching.settings import MatchingSettings, SpectralLossWeights
from ssm_pipeline.settings import Settings


class TrainingSettings(Settings):
    steps: int = Field(1500, ge=1)  # optimiser steps, one pair each
    faces: int = Field(2000, ge=200)  # triangles of the coarser meshes trained on
    learning_rate: float = Field(1e-3, gt=0)  # Adam, at the start
    final_learning_rate: float = Field(1e-4, gt=0)  # reached by a cosine
    gradient_clip: float = Field(1.0, gt=0)  # largest norm of the gradient
    time_steps: tuple[int, ...] = (0, 2, 4, 6)  # T, growing during training
    time_step_shares: tuple[float, ...] = (0.7, 0.1, 0.1, 0.1)  # of the steps, for each T
    checkpoint_every: int = Field(50, ge=1)  # steps between checkpoints
    template_pairs: int = Field(8, ge=1)  # partners each candidate template is tried on
    matching: MatchingSettings = MatchingSettings()
    interpolation: InterpolationSettings = InterpolationSettings()
    spectral_loss: SpectralLossWeights = SpectralLossWeights()
    spatial_loss: SpatialLossWeights = SpatialLossWeights()

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
        return self.model_copy(update={"spatial_loss": SpatialLossWeights.none()})

    def time_steps_at(self, step: int) -> int:
        """T at an optimiser step."""
        reached = 0.0
        for T, share in zip(self.time_steps, self.time_step_shares, strict=True):
            reached += share
            if step < reached * self.steps - 1e-9:
                return T
        return self.time_steps[-1]

"""Settings of the articulated figures, apart from what makes them: reading settings stays quick."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from ssm_pipeline.settings import Settings

# What chose a default is never what is reported: tune on the first, report the second.
DEVELOPMENT_SEED = 100
REPORTED_SEED = 200


class ArticulatedSettings(Settings):
    """A set of posed figures: the shapes to train on first, then the ones to test on."""

    family: Literal["near-isometric", "non-isometric", "merged limbs"] = "near-isometric"
    seed: int = Field(REPORTED_SEED, ge=0)  # of bodies, poses and triangulations
    training_shapes: int = Field(40, ge=1)  # shapes
    test_shapes: int = Field(10, ge=2)  # shapes; half of them of a person never trained on
    persons: int = Field(4, ge=1)  # near-isometric: bodies that the training shapes share
    vertices: int = Field(5000, ge=500)  # per shape, about; drawn from 10 % less to 10 % more
    template_vertices: int = Field(5000, ge=100)  # points with known positions, about

    @property
    def training_range(self) -> range:
        return range(self.training_shapes)

    @property
    def test_range(self) -> range:
        return range(self.training_shapes, self.training_shapes + self.test_shapes)

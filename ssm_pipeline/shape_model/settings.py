"""Settings of the groupwise rounds and of the shape model."""

from __future__ import annotations

from pydantic import Field

from ssm_pipeline.settings import Settings


class GroupwiseSettings(Settings):
    # Each: the mean of the shapes so far, in the template's place, adapted to every case anew.
    rounds: int = Field(3, ge=0)


class ShapeModelSettings(Settings):
    with_scale: bool = False  # alignment also removes size; False keeps it as a mode

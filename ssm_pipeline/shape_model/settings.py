"""Settings of the groupwise rounds and of the shape model."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from ssm_pipeline.settings import Settings


class GroupwiseSettings(Settings):
    # In each round the mean of the shapes so far is adapted to every case, as the template was.
    rounds: int = Field(3, ge=0)
    # How the mean is aligned with a case before adaptation: by the best rotation, translation and
    # scale of its points, or by the best affine map, which bends the mean to each case's slides.
    laid_on: Literal["similarity", "affine"] = "similarity"


class ShapeModelSettings(Settings):
    with_scale: bool = False  # alignment also removes size; False keeps it as a mode

"""Settings of the interpolator and the spatial loss."""

from __future__ import annotations

from pydantic import Field

from ssm_pipeline.settings import Settings


class InterpolationSettings(Settings):
    width: int = Field(128, ge=1)  # hidden channels
    blocks: int = Field(5, ge=1)  # EdgeConv blocks


class SpatialLossWeights(Settings):
    align: float = Field(5.0, ge=0)  # λ_align
    arap: float = Field(100.0, ge=0)  # λ_arap
    symmetry: float = Field(1.0, ge=0)  # λ_sym
    variance: float = Field(1.0, ge=0)  # λ_var; the authors' code: 0
    dirichlet: float = Field(0.0, ge=0)  # of Π_xy Y; absent in the paper, the authors' code: 2

    @classmethod
    def none(cls) -> SpatialLossWeights:
        return cls(align=0, arap=0, symmetry=0, variance=0, dirichlet=0)

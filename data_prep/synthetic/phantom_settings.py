"""Settings of the synthetic cohorts, apart from what makes them: reading settings stays quick."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from ssm_pipeline.settings import Settings

Family = Literal["lung", "tube", "smooth"]


class PhantomSettings(Settings):
    # lung: local modes, residuals, scanners' faults; tube: the same of a small bent organ;
    # smooth: star-shaped lungs of five modes, nearly affine, to see how much easier those are.
    family: Family = "lung"
    cases: int = Field(12, ge=2)  # scans
    modes: int | None = Field(None, ge=1)  # ways to vary, standard normal; None: all (smooth: 5)
    seed: int = Field(0, ge=0, lt=2**32)  # of modes, scores and poses
    spacing_mm: tuple[float, float, float] | None = None  # mm, x, y, z; None: each its own
    max_rotation_deg: float = Field(0.0, ge=0, le=180)  # degrees; evenly of all turns up to this
    translation_mm: float = Field(5.0, ge=0)  # mm, standard deviation along each axis
    # Of the families lung and tube; None: as that family has it.
    residual_mm: float | None = Field(None, ge=0)  # mm rms, each case's own smooth deformation
    voxel_noise: float = Field(0.2, ge=0, le=0.5)  # of a voxel's occupancy, standard deviation
    bridge_share: float | None = Field(None, ge=0, le=1)  # of the cases: a bridge or a tunnel
    cut_share: float | None = Field(None, ge=0, le=1)  # of the cases: top or bottom out of view

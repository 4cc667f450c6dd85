"""Settings of the synthetic lungs, apart from what makes them: reading settings stays quick."""

from __future__ import annotations

from pydantic import Field

from ssm_pipeline.settings import Settings


class PhantomSettings(Settings):
    cases: int = Field(12, ge=2)  # scans
    modes: int = Field(5, ge=1, le=6)  # ways to vary, scores of standard deviation 1 each
    seed: int = 0
    spacing_mm: tuple[float, float, float] = (1.0, 1.0, 1.5)  # mm, voxel size along x, y, z
    max_rotation_deg: float = Field(0.0, ge=0, le=180)  # degrees; evenly of all turns up to this
    translation_mm: float = Field(5.0, ge=0)  # mm, standard deviation along each axis

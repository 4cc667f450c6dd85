"""Settings of the spectral stage."""

from __future__ import annotations

from pydantic import Field

from ssm_pipeline.settings import Settings


class SpectralSettings(Settings):
    eigenpairs: int = Field(200, ge=2)  # k; the paper: 200, near-isometric cohorts 300

"""Settings of the plain registrations that the method is compared with."""

from __future__ import annotations

from pydantic import Field

from ssm_pipeline.settings import Settings


class RegistrationSettings(Settings):
    """Chosen on development phantoms only (benchmarks/tune_rivals.py)."""

    # Affine: iterative closest points with twelve unknowns.
    affine_points: int = Field(4000, ge=100)  # samples on each surface
    affine_steps: int = Field(60, ge=1)  # at most

    # Non-rigid ICP (Amberg et al. 2007): the smoothness term's weight falls step by step.
    nricp_smoothness: tuple[float, ...] = Field((3e-2, 1e-2, 3e-3, 1e-3), min_length=1)
    nricp_normals: float = Field(0.5, ge=0)  # weight of the normals' agreement
    nricp_steps: int = Field(3, ge=1)  # a smoothness

    # Coherent point drift (Myronenko and Song 2010), on clouds scaled to unit variance.
    cpd_width: float = Field(3.0, gt=0)  # β: of the Gaussian kernel of the prior on displacements
    cpd_strength: float = Field(8.0, gt=0)  # α: of the prior
    cpd_outliers: float = Field(0.0, ge=0, lt=1)  # share of points that match nothing
    cpd_columns: int = Field(300, ge=10)  # of the kernel, by pivoted Cholesky
    cpd_steps: int = Field(100, ge=1)  # at most

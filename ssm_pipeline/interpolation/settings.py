"""Settings of the interpolator and the spatial loss."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from ssm_pipeline.settings import Settings


class InterpolationSettings(Settings):
    width: int = Field(128, ge=1)  # hidden channels
    blocks: int = Field(5, ge=1)  # EdgeConv blocks


class SpatialLossSettings(Settings):
    """Weights of the spatial loss, and which of its forms.

    Norms over vertices are weighted by area, times `vertices`: a weight means the same on a mesh
    of 1000 vertices and of 8000.
    """

    align: float = Field(5.0, ge=0)  # λ_align
    arap: float = Field(100.0, ge=0)  # λ_arap
    symmetry: float = Field(1.0, ge=0)  # λ_sym
    variance: float = Field(1.0, ge=0)  # λ_var; the authors' code: 0
    dirichlet: float = Field(2.0, ge=0)  # of Π_xy Y; absent in the paper, the authors' code: 2
    vertices: int = Field(5000, ge=1)  # of the meshes that the weights were set for
    # cycle: ‖X − Π_xy Y(1)‖², as in the authors' code: zero only for a map sharp enough to bring
    # X back. printed: ‖X(1) − Π_xy Y‖², zero for any map, however blurred.
    align_form: Literal["cycle", "printed"] = "cycle"
    # uniform: Eq. 12 as printed. cotangent: the same on equilateral triangles, and it does not
    # move with the triangulation.
    arap_edges: Literal["cotangent", "uniform"] = "cotangent"
    arap_both_ways: bool = False  # from X_k+1 to X_k too, as in the authors' code
    symmetry_mean: bool = False  # over the time steps, as in the authors' code; the paper: sum

    @classmethod
    def none(cls) -> SpatialLossSettings:
        return cls(align=0, arap=0, symmetry=0, variance=0, dirichlet=0)

    @property
    def is_none(self) -> bool:
        return not any((self.align, self.arap, self.symmetry, self.variance, self.dirichlet))

"""Settings of the step from mask to mesh."""

from __future__ import annotations

from pydantic import Field

from ssm_pipeline.settings import Settings


class MeshingSettings(Settings):
    """`None` for a length means: chosen from the organ's size."""

    faces: int = Field(8000, ge=100)  # triangles of the finished mesh
    voxel_mm: float | None = Field(None, gt=0)  # mm, isotropic grid; None: up to 1.5, by size
    smoothing_mm: float | None = Field(None, gt=0)  # mm, Gaussian sigma; None: up to 2, by size
    laplacian_steps: int = Field(10, ge=0)  # steps on the extracted surface
    hole_percent: float = Field(1.0, ge=0, le=100)  # of a surface's area: larger holes drop it
    cut_handles: bool = True  # make the surface a topological sphere; false keeps rings
    keep_thin_parts: bool = True  # a finer grid and less blur where a thin part would vanish
    fast_faces: int = Field(40_000, ge=100)  # triangles left to the slower, exact decimation

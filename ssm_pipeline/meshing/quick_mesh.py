"""A coarse mesh in little time: enough to see whether a case is what it should be."""

from __future__ import annotations

from ssm_pipeline.meshing.mask_to_mesh import mesh_with_quality
from ssm_pipeline.meshing.quality import MeshQuality
from ssm_pipeline.meshing.settings import MeshingSettings
from ssm_pipeline.meshing.surface_to_mesh import mesh_from_surface
from ssm_pipeline.records import Mask, Mesh, Surface

FACES = 2000
STEP = 0.03  # of the organ's length, the cube root of its volume: a tenth of the usual voxels


def quick_mesh(case: Mask | Surface, settings: MeshingSettings) -> tuple[Mesh, MeshQuality]:
    """`mesh_with_quality` or `mesh_from_surface` of few triangles.

    Raises:
        CaseError: As they do.
    """
    coarse = settings.model_copy(update={"faces": min(FACES, settings.faces)})
    if isinstance(case, Surface):
        return mesh_from_surface(case, coarse)
    length_mm = case.volume_mm3 ** (1 / 3)
    step = min(max(STEP * length_mm, 0.1), 0.1 * length_mm)  # an organ below 1 mm: no 0.1 mm
    return mesh_with_quality(case, coarse.model_copy(update={"voxel_mm": step}))

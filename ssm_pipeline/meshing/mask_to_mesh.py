"""Mask → closed, oriented, manifold mesh in patient millimetres, with the mask's volume."""

from __future__ import annotations

import numpy as np

from ssm_pipeline.geometry.topology import is_oriented_manifold
from ssm_pipeline.meshing.decimation import decimate, reduce_fast
from ssm_pipeline.meshing.handles import cut_handles
from ssm_pipeline.meshing.isosurface import isosurface
from ssm_pipeline.meshing.organ import keep_organ
from ssm_pipeline.meshing.quality import MeshQuality, measure_quality
from ssm_pipeline.meshing.settings import MeshingSettings
from ssm_pipeline.meshing.smooth_field import smooth_field
from ssm_pipeline.meshing.smoothing import laplacian_smoothing, restore_volume
from ssm_pipeline.records import CaseError, Mask, Mesh


def mesh_with_quality(mask: Mask, settings: MeshingSettings) -> tuple[Mesh, MeshQuality]:
    """Crop, keep the largest piece, fill cavities, blur, extract, smooth, cut handles, decimate.

    The blur's level is the one that keeps the volume, and what smoothing and decimation take off is
    given back along the normals. Handles, which the hilum of a lung leaves, mostly vanish in the
    blur; the rest are cut on the surface (see `handles`).

    Raises:
        CaseError: If no closed manifold surface results.

    Source: Cao et al. 2024, the LUNA16 experiment (marching cubes, Laplacian smoothing, quadric
    decimation to about 8000 triangles); the rest is ours.
    """
    organ, cleaning = keep_organ(mask)
    voxel_mm, smoothing_mm = grid_sizes(organ.volume_mm3, settings)
    surface = isosurface(smooth_field(organ, voxel_mm, smoothing_mm), mask.case_id)
    if not is_oriented_manifold(surface.faces):
        raise CaseError(
            mask.case_id,
            "the surface is not a closed manifold. Try more smoothing (smoothing_mm) or a finer "
            "grid (voxel_mm).",
        )
    smooth = laplacian_smoothing(surface.vertices, surface.faces, settings.laplacian_steps)
    surface = reduce_fast(Mesh(smooth, surface.faces, mask.case_id), settings.fast_faces)
    handles_cut = 0
    if settings.cut_handles:
        surface, handles_cut = cut_handles(surface)
    vertices = restore_volume(surface.vertices, surface.faces, organ.volume_mm3)
    mesh = decimate(Mesh(vertices, surface.faces, mask.case_id), settings.faces)
    return mesh, measure_quality(mesh, organ, cleaning, handles_cut, voxel_mm, smoothing_mm)


def grid_sizes(volume_mm3: float, settings: MeshingSettings) -> tuple[float, float]:
    """(voxel_mm, smoothing_mm) as set, or from the organ's size.

    With L the cube root of the volume: sigma L/20, at most 2 mm (a 2 l lung: 2 mm; a 3 ml
    hippocampus: 0.7 mm). The grid gives at least three times the triangles wanted, at most 1.5 mm.
    """
    length = volume_mm3 ** (1 / 3)
    smoothing_mm = settings.smoothing_mm or min(2.0, length / 20)
    area_mm2 = 7 * length**2  # a cube has 6 L², a sphere 4.8 L²; organs are less compact
    # A level set on a grid of step h has about 2.9 A/h² triangles.
    finest = float(np.sqrt(2.5 * area_mm2 / (3 * settings.faces)))
    voxel_mm = settings.voxel_mm or min(1.5, finest)
    return voxel_mm, smoothing_mm

"""Mask → closed, oriented, manifold mesh in patient millimetres, with the mask's volume."""

from __future__ import annotations

import numpy as np

from ssm_pipeline.geometry.topology import is_oriented_manifold
from ssm_pipeline.meshing.decimation import decimate, reduce_fast
from ssm_pipeline.meshing.handles import Handle, cut_handles
from ssm_pipeline.meshing.isosurface import isosurface
from ssm_pipeline.meshing.loss_texts import handle_texts, kept_text, lost_texts
from ssm_pipeline.meshing.losses import lost_pieces
from ssm_pipeline.meshing.organ import keep_organ
from ssm_pipeline.meshing.quality import MeshQuality, measure_quality, with_losses
from ssm_pipeline.meshing.settings import MeshingSettings
from ssm_pipeline.meshing.smooth_field import LEAST_SIGMA, SmoothField, smooth_field
from ssm_pipeline.meshing.smoothing import laplacian_smoothing, restore_volume
from ssm_pipeline.records import CaseError, Mask, Mesh

LOST_SHARE = 0.2  # of the organ's length: a part that reaches farther out is kept, or reported
_THIN_POINTS = 3e7  # of the finer grid for thin parts


def mesh_with_quality(mask: Mask, settings: MeshingSettings) -> tuple[Mesh, MeshQuality]:
    """Make a closed mesh of the largest piece of a mask.

    The steps: crop, keep the largest piece, fill cavities, blur, extract, smooth, cut handles,
    decimate. The level set keeps the organ's volume, and what smoothing and decimation remove is
    restored along the normals. Handles at the hilum of a lung mostly vanish in the blur; the rest
    are cut on the surface (see `handles`). Where the blur removes a thin part (see `losses`), the
    mesh is made again on a finer grid with less blur near that part.

    Raises:
        CaseError: No closed manifold surface results.

    Source: Cao et al. 2024, the LUNA16 experiment (marching cubes, Laplacian smoothing, quadric
    decimation to about 8000 triangles). Differs: the blur, its level and the repairs.
    """
    organ, cleaning = keep_organ(mask)
    voxel_mm, smoothing_mm = grid_sizes(organ.volume_mm3, settings)
    tolerance_mm = max(smoothing_mm, LEAST_SIGMA * float(organ.spacing_mm.max()))
    noticed_mm = max(LOST_SHARE * organ.volume_mm3 ** (1 / 3), tolerance_mm)
    mesh, handles = _mesh_of(organ, smooth_field(organ, voxel_mm, smoothing_mm), settings)
    lost = lost_pieces(mesh, organ, tolerance_mm)
    thin = [piece for piece in lost if piece.depth_mm > noticed_mm]
    told: list[str] = []
    if thin and settings.keep_thin_parts:
        voxel_mm = _finer_grid(organ, voxel_mm)
        near = np.zeros(organ.voxels.shape, bool)
        for piece in thin:
            near[tuple(piece.voxels.T)] = True
        field = smooth_field(organ, voxel_mm, smoothing_mm, near)
        mesh, handles = _mesh_of(organ, field, settings)
        lost = lost_pieces(mesh, organ, tolerance_mm)
        still = [piece for piece in lost if piece.depth_mm > noticed_mm]
        if len(still) < len(thin):
            told.append(kept_text(thin, voxel_mm))
        thin = still
    told += lost_texts(thin, settings.keep_thin_parts)
    told += handle_texts(handles, organ.volume_mm3)
    quality = measure_quality(mesh, organ, cleaning, len(handles), voxel_mm, smoothing_mm)
    return mesh, with_losses(quality, lost, told)


def _mesh_of(
    organ: Mask, field: SmoothField, settings: MeshingSettings
) -> tuple[Mesh, tuple[Handle, ...]]:
    """The level set of the field, smoothed and decimated, with the organ's volume."""
    surface = isosurface(field, organ.case_id)
    if not is_oriented_manifold(surface.faces):
        raise CaseError(
            organ.case_id,
            "the surface is not a closed manifold. Try more smoothing (meshing.smoothing_mm) or a "
            "finer grid (meshing.voxel_mm).",
        )
    smooth = laplacian_smoothing(surface.vertices, surface.faces, settings.laplacian_steps)
    surface = reduce_fast(Mesh(smooth, surface.faces, organ.case_id), settings.fast_faces)
    handles: tuple[Handle, ...] = ()
    if settings.cut_handles:
        surface, handles = cut_handles(surface)
    vertices = restore_volume(surface.vertices, surface.faces, organ.volume_mm3)
    return decimate(Mesh(vertices, surface.faces, organ.case_id), settings.faces), handles


def _finer_grid(organ: Mask, voxel_mm: float) -> float:
    """Half a voxel of the mask along its finest axis, as far as memory allows."""
    box_mm3 = float(np.prod(np.array(organ.voxels.shape[::-1]) * organ.spacing_mm))
    affordable = float(np.cbrt(box_mm3 / _THIN_POINTS))
    return min(voxel_mm, max(0.5 * float(organ.spacing_mm.min()), affordable))


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

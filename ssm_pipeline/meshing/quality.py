"""How good a mesh is, and how true to the mask it came from."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.geometry.distances import SurfaceDistance, SurfaceTarget, surface_distance
from ssm_pipeline.geometry.surface import area, sample_points, volume
from ssm_pipeline.geometry.topology import boundary_loop_count, euler_number, min_angle_deg
from ssm_pipeline.meshing.losses import Piece
from ssm_pipeline.meshing.organ import Cleaning
from ssm_pipeline.records import Mask, Mesh

_SAMPLES = 10_000


@dataclass(frozen=True, kw_only=True)
class MeshQuality:
    """What the report says of one case's mesh.

    Attributes:
        euler_number: 2 for a topological sphere, which it is after handles_cut handles were cut.
        mask_volume_ml: Of the mask as read; of a surface, once its holes are closed. The change is
            the mesh's against it.
        pieces, left_out_ml, cavities_filled_ml: The mask's connected pieces, and what of it was
            left out or filled to make one solid organ.
        surface_mean_mm, surface_hd95_mm: Symmetric distance between the mesh and what it was made
            of: mean and 95th percentile over both directions. Of a mask, the outer faces of the
            organ's voxels.
        surface_max_mm: Largest distance from the surface that the mesh was made of to the mesh; of
            a mask, from its voxels outside the mesh and sampled voxel faces.
        lost_piece_ml, lost_piece_mm: The largest connected part of the mask that the mesh lacks:
            its volume beyond the blur's sigma, and how far it reaches from the mesh.
        voxel_mm, smoothing_mm: Of the grid between mask and mesh; of a surface, NaN and 0.
        warnings: In words: what was left out, filled, lost or repaired, where it is worth a look.
    """

    vertices: int
    faces: int
    euler_number: int
    boundary_loops: int
    handles_cut: int
    min_angle_deg: float
    area_cm2: float
    volume_ml: float
    mask_volume_ml: float
    volume_change_percent: float
    pieces: int = 1
    left_out_ml: float = 0.0
    cavities_filled_ml: float = 0.0
    surface_mean_mm: float
    surface_hd95_mm: float
    surface_max_mm: float
    lost_piece_ml: float = 0.0
    lost_piece_mm: float = 0.0
    voxel_mm: float = np.nan
    smoothing_mm: float = 0.0
    warnings: tuple[str, ...]


def measure_quality(
    mesh: Mesh,
    organ: Mask,
    cleaning: Cleaning,
    handles_cut: int,
    voxel_mm: float,
    smoothing_mm: float,
) -> MeshQuality:
    """Measure a mesh against the organ it was made from."""
    from_mesh, from_mask = mesh_to_mask_distances(mesh, organ)
    distances = np.concatenate([from_mesh, from_mask])
    distance = SurfaceDistance(float(distances.mean()), float(np.percentile(distances, 95)))
    largest = float(from_mask.max())
    return dataclasses.replace(
        _quality(mesh, cleaning.given, distance, largest, handles_cut, cleaning.warnings),
        pieces=cleaning.pieces,
        left_out_ml=cleaning.left_out / 1000,
        cavities_filled_ml=cleaning.filled / 1000,
        voxel_mm=voxel_mm,
        smoothing_mm=smoothing_mm,
    )


def with_losses(quality: MeshQuality, lost: tuple[Piece, ...], told: Sequence[str]) -> MeshQuality:
    """The quality with the largest lost piece of the mask, and further warnings."""
    depth = max((piece.depth_mm for piece in lost), default=0.0)
    return dataclasses.replace(
        quality,
        surface_max_mm=max(quality.surface_max_mm, depth),
        lost_piece_ml=lost[0].volume_ml if lost else 0.0,
        lost_piece_mm=lost[0].depth_mm if lost else 0.0,
        warnings=(*quality.warnings, *told),
    )


def measure_surface_quality(
    mesh: Mesh, surface: Mesh, handles_cut: int, told: tuple[str, ...]
) -> MeshQuality:
    """Measure a mesh against the closed surface it was made from; `told`: how it was repaired."""
    distance = surface_distance(
        SurfaceTarget.of(mesh.vertices, mesh.faces),
        SurfaceTarget.of(surface.vertices, surface.faces),
    )
    largest = float(closest_points(surface.vertices, mesh.vertices, mesh.faces).distances.max())
    given_mm3 = volume(surface.vertices, surface.faces)
    return _quality(mesh, given_mm3, distance, largest, handles_cut, told)


def _quality(
    mesh: Mesh,
    given_mm3: float,
    distance: SurfaceDistance,
    largest_mm: float,
    handles_cut: int,
    warnings: tuple[str, ...],
) -> MeshQuality:
    """Of a mesh in one piece, made without a grid; given_mm3: the volume of what it was made of."""
    volume_mm3 = volume(mesh.vertices, mesh.faces)
    return MeshQuality(
        vertices=len(mesh.vertices),
        faces=len(mesh.faces),
        euler_number=euler_number(mesh.faces),
        boundary_loops=boundary_loop_count(mesh.faces),
        handles_cut=handles_cut,
        min_angle_deg=min_angle_deg(mesh.vertices, mesh.faces),
        area_cm2=area(mesh.vertices, mesh.faces) / 100,
        volume_ml=volume_mm3 / 1000,
        mask_volume_ml=given_mm3 / 1000,
        volume_change_percent=100 * (volume_mm3 / given_mm3 - 1),
        surface_mean_mm=distance.mean,
        surface_hd95_mm=distance.hd95,
        surface_max_mm=largest_mm,
        warnings=warnings,
    )


def mesh_to_mask_distances(mesh: Mesh, organ: Mask) -> tuple[np.ndarray, np.ndarray]:
    """(≤ 10 000,) mm each: evenly sampled distances mesh → voxel faces, voxel faces → mesh."""
    centres, half_sizes = _voxel_faces(organ)
    stride = max(1, len(centres) // _SAMPLES)
    world = centres[::stride] @ organ.direction.T + organ.origin_mm
    mask_to_mesh = closest_points(world, mesh.vertices, mesh.faces).distances
    generator = np.random.default_rng(0)  # the same points at every measurement of a mesh
    samples = sample_points(mesh.vertices, mesh.faces, _SAMPLES, generator)
    local = (samples - organ.origin_mm) @ organ.direction
    count = min(8, len(centres))
    _, nearest = cKDTree(centres).query(local, k=count, workers=-1)
    # Exact distance to each of the eight nearest rectangles: thick slices have large ones.
    gap = np.abs(local[:, None] - centres[nearest]) - half_sizes[nearest]
    mesh_to_mask = np.linalg.norm(np.maximum(gap, 0), axis=2).min(axis=1)
    return mesh_to_mask, mask_to_mesh


def _voxel_faces(organ: Mask) -> tuple[np.ndarray, np.ndarray]:
    """(B, 3) centres and half sizes of the voxel faces between organ and outside, in millimetres
    along the image axes x, y, z from the first voxel."""
    inside = np.pad(organ.voxels, 1)
    centres, half_sizes = [], []
    for axis in range(3):  # of the array: z, y, x
        lower = tuple(slice(None, -1) if a == axis else slice(None) for a in range(3))
        upper = tuple(slice(1, None) if a == axis else slice(None) for a in range(3))
        index = np.argwhere(inside[lower] != inside[upper])[:, ::-1] - 1.0
        index[:, 2 - axis] += 0.5
        half = 0.5 * organ.spacing_mm
        half[2 - axis] = 0
        centres.append(index * organ.spacing_mm)
        half_sizes.append(np.broadcast_to(half, index.shape))
    return np.concatenate(centres), np.concatenate(half_sizes)

"""How good a mesh is, and how true to the mask it came from."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.geometry.distances import SurfaceDistance, SurfaceTarget, surface_distance
from ssm_pipeline.geometry.surface import area, sample_points, volume
from ssm_pipeline.geometry.topology import boundary_loop_count, euler_number, min_angle_deg
from ssm_pipeline.meshing.organ import Cleaning
from ssm_pipeline.records import Mask, Mesh

_SAMPLES = 10_000


@dataclass(frozen=True, kw_only=True)
class MeshQuality:
    """What the report says of one case's mesh.

    Attributes:
        euler_number: 2 for a topological sphere; handles_cut were taken away to get there.
        mask_volume_ml: Of the mask as read; of a surface, once its holes are closed. The change is
            the mesh's against it.
        pieces, left_out_ml, cavities_filled_ml: What the mask fell into, and what of it was left
            out or filled to make one solid organ.
        surface_mean_mm, surface_hd95_mm: Symmetric distance between the mesh and what it was made
            of: mean and 95th percentile over both directions. Of a mask, the outer faces of the
            organ's voxels.
        voxel_mm, smoothing_mm: Of the grid between mask and mesh; of a surface, NaN and 0.
        warnings: What was left out, filled or mended, in words, where it is worth a look.
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
    distances = mesh_to_mask_distances(mesh, organ)
    distance = SurfaceDistance(float(distances.mean()), float(np.percentile(distances, 95)))
    return dataclasses.replace(
        _quality(mesh, cleaning.given, distance, handles_cut, cleaning.warnings),
        pieces=cleaning.pieces,
        left_out_ml=cleaning.left_out / 1000,
        cavities_filled_ml=cleaning.filled / 1000,
        voxel_mm=voxel_mm,
        smoothing_mm=smoothing_mm,
    )


def measure_surface_quality(
    mesh: Mesh, surface: Mesh, handles_cut: int, told: tuple[str, ...]
) -> MeshQuality:
    """Measure a mesh against the closed surface it was made from; `told`: how that was mended."""
    distance = surface_distance(
        SurfaceTarget.of(mesh.vertices, mesh.faces),
        SurfaceTarget.of(surface.vertices, surface.faces),
    )
    return _quality(mesh, volume(surface.vertices, surface.faces), distance, handles_cut, told)


def _quality(
    mesh: Mesh,
    given_mm3: float,
    distance: SurfaceDistance,
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
        warnings=warnings,
    )


def mesh_to_mask_distances(mesh: Mesh, organ: Mask) -> np.ndarray:
    """(≤ 20 000,) mm: evenly sampled distances mesh → voxel faces and voxel faces → mesh."""
    centres, half_sizes = _voxel_faces(organ)
    stride = max(1, len(centres) // _SAMPLES)
    world = centres[::stride] @ organ.direction.T + organ.origin_mm
    mask_to_mesh = closest_points(world, mesh.vertices, mesh.faces).distances
    generator = np.random.default_rng(0)  # the same points at every measurement of a mesh
    samples = sample_points(mesh.vertices, mesh.faces, _SAMPLES, generator)
    local = (samples - organ.origin_mm) @ organ.direction
    _, nearest = cKDTree(centres).query(local, k=8, workers=-1)
    # Exact distance to each of the eight nearest rectangles: thick slices have large ones.
    gap = np.abs(local[:, None] - centres[nearest]) - half_sizes[nearest]
    mesh_to_mask = np.linalg.norm(np.maximum(gap, 0), axis=2).min(axis=1)
    return np.concatenate([mesh_to_mask, mask_to_mesh])


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

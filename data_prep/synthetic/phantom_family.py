"""What a family of phantoms is: a mean surface, how it varies, and how its scans look."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pymeshlab
from skimage.measure import marching_cubes

from ssm_pipeline.data_prep.synthetic.phantom_flow import Velocity


@dataclass(frozen=True, eq=False)
class PhantomFamily:
    """An anatomy, in LPS millimetres.

    residual_mm, residual_widths_mm
                      size and widths of what no mode describes, each case's own.
    in_plane_mm, slice_mm
                      range of voxel sizes along x and y, and along z.
    bridge_share, cut_share
                      of the cases, those with a bridge or tunnel, and those whose top or bottom
                      lies outside the field of view.

    Attributes:
        vertices, faces: The mean surface: closed, outward, about even triangles.
        modes: Velocity fields, one standard deviation each.
        border: (V,) mm: on which side of the border between the two labels a vertex lies; label 1
            where negative, 2 elsewhere.
        pivot: (3,) mm, what a turned patient turns about.
        bridge_mm: Radius of bridges and tunnels, `hilum` (K,) the vertices they start from.
    """

    organ: str
    vertices: np.ndarray
    faces: np.ndarray
    modes: tuple[Velocity, ...]
    border: np.ndarray
    pivot: np.ndarray
    residual_mm: float
    residual_widths_mm: tuple[float, ...]
    in_plane_mm: tuple[float, float]
    slice_mm: tuple[float, float]
    hilum: np.ndarray
    bridge_mm: float = 0.0
    bridge_share: float = 0.0
    cut_share: float = 0.0


def level_surface(
    outside_mm: Callable[[np.ndarray], np.ndarray],
    low: tuple[float, float, float],
    high: tuple[float, float, float],
    step_mm: float,
    edge_mm: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) mm and faces (F, 3) of {outside_mm = 0}, in even triangles.

    Args:
        outside_mm: (Q, 3) → (Q,) about the signed distance, negative inside.
        low, high: Corners of the box searched on a grid of `step_mm`
        edge_mm: Of the triangles.
    """
    axes = [np.arange(a, b + step_mm, step_mm) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    values = outside_mm(grid.reshape(-1, 3)).reshape(grid.shape[:3])
    vertices, faces, _, _ = marching_cubes(values, 0.0, spacing=(step_mm,) * 3)
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh((vertices + low).astype(np.float64), faces))
    meshes.meshing_isotropic_explicit_remeshing(
        targetlen=pymeshlab.PureValue(edge_mm), iterations=6
    )
    result = meshes.current_mesh()
    vertices, faces = result.vertex_matrix(), result.face_matrix().astype(np.int64)
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    if np.einsum("fd,fd->", a, np.cross(b, c)) < 0:
        faces = faces[:, ::-1]
    return np.ascontiguousarray(vertices), np.ascontiguousarray(faces)


def smooth_maximum(fields: np.ndarray, blend_mm: float) -> np.ndarray:
    """(K, Q) → (Q,): the largest, edges rounded at about `blend_mm`. The smallest if negative."""
    top = (fields / blend_mm).max(axis=0)
    result: np.ndarray = blend_mm * (top + np.log(np.exp(fields / blend_mm - top).sum(axis=0)))
    return result

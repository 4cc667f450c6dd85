"""Handles are cut at their short loop: at the tube of a thin ring, in the hole of a fat one."""

import numpy as np
import pytest
import trimesh

from ssm_pipeline.geometry.surface import area, volume
from ssm_pipeline.geometry.topology import euler_number, is_oriented_manifold
from ssm_pipeline.meshing.handles import cut_handles
from ssm_pipeline.records import Mesh


def torus_mesh(ring: float, tube: float) -> Mesh:
    torus = trimesh.creation.torus(ring, tube, major_sections=60, minor_sections=30)
    return Mesh(torus.vertices, torus.faces, "torus")


@pytest.mark.parametrize(("ring", "tube"), [(30.0, 4.0), (12.0, 10.5)])
def test_the_cut_is_the_small_one(ring: float, tube: float) -> None:
    mesh = torus_mesh(ring, tube)
    cut, (handle,) = cut_handles(mesh)
    # The middle of the tube's section, or of the hole; the loop runs around it along edges.
    thin = tube < ring / 2
    assert handle.is_filled is not thin
    assert np.hypot(*handle.centre_mm[:2]) == pytest.approx(ring if thin else 0, abs=0.5)
    radius = tube if thin else ring - tube
    assert handle.loop_mm == pytest.approx(2 * np.pi * radius, rel=0.2)  # zigzag
    assert euler_number(cut.faces) == 2
    assert is_oriented_manifold(cut.faces)
    # Two membranes of the short loop, radius 4 or 1.5 mm; the other loop's are ten times larger.
    grown = area(cut.vertices, cut.faces) / area(mesh.vertices, mesh.faces) - 1
    assert abs(grown) < 0.05
    assert volume(cut.vertices, cut.faces) == pytest.approx(
        volume(mesh.vertices, mesh.faces), rel=0.05
    )


def test_only_the_neighbourhood_of_the_cut_moves() -> None:
    mesh = torus_mesh(30.0, 4.0)
    cut, _ = cut_handles(mesh)
    kept = {tuple(vertex) for vertex in mesh.vertices} & {tuple(vertex) for vertex in cut.vertices}
    assert len(kept) > 0.9 * len(mesh.vertices)


def test_a_chain_of_rings_loses_every_handle() -> None:
    grid = np.stack(np.meshgrid(*(np.arange(-1.0, 2.0),) * 3, indexing="ij"), axis=-1)
    # A frame of 12 bars around a cube: 8 corners, 12 edges, hence 12 - 8 + 1 = 5 handles.
    voxels = (np.abs(grid).astype(int) == 1).sum(axis=-1) >= 2
    fine = np.kron(voxels, np.ones((6, 6, 6), bool))
    mesh = trimesh.voxel.ops.matrix_to_marching_cubes(np.pad(fine, 1))
    frame = Mesh(mesh.vertices, mesh.faces, "frame")
    assert euler_number(frame.faces) == 2 - 2 * 5
    cut, handles = cut_handles(frame)
    assert len(handles) == 5
    assert euler_number(cut.faces) == 2
    assert is_oriented_manifold(cut.faces)


def test_a_sphere_is_left_alone() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=2)
    mesh = Mesh(sphere.vertices, sphere.faces, "sphere")
    cut, handles = cut_handles(mesh)
    assert handles == ()
    assert cut is mesh

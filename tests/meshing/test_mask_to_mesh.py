"""Meshes of solids with known volume, area, position and topology."""

import numpy as np
import pytest
import trimesh
from mask_shapes import ball, mask_of, torus
from scipy.spatial.transform import Rotation

from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.geometry.surface import centroid, face_normals, volume
from ssm_pipeline.geometry.topology import is_oriented_manifold
from ssm_pipeline.meshing.mask_to_mesh import grid_sizes, mesh_with_quality
from ssm_pipeline.meshing.settings import MeshingSettings
from ssm_pipeline.records import CaseError, Mask

COARSE = MeshingSettings(faces=2000)


def test_ball() -> None:
    radius = 20.0
    mesh, quality = mesh_with_quality(mask_of(ball(radius), 25), COARSE)
    assert quality.faces == len(mesh.faces) <= 2000
    assert (quality.euler_number, quality.boundary_loops, quality.handles_cut) == (2, 0, 0)
    assert is_oriented_manifold(mesh.faces)
    assert quality.volume_change_percent == pytest.approx(0, abs=0.05)
    # The mask itself is 0.2 % off the ball; 2000 flat triangles are 0.3 % short in area.
    assert quality.volume_ml == pytest.approx(4 / 3 * np.pi * radius**3 / 1000, rel=0.005)
    assert quality.area_cm2 == pytest.approx(4 * np.pi * radius**2 / 100, rel=0.005)
    radii = np.linalg.norm(mesh.vertices, axis=1)
    assert np.abs(radii - radius).max() < 0.3  # a third of a voxel
    assert quality.surface_hd95_mm < 1.0  # voxel corners stand out by up to 0.87 mm
    assert quality.min_angle_deg > 15


def test_thick_slices_leave_no_stairs() -> None:
    radius = 20.0
    mesh, _ = mesh_with_quality(mask_of(ball(radius), 26, (0.8, 0.8, 3.0)), COARSE)
    normals = face_normals(mesh.vertices, mesh.faces)
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    cosine = np.einsum("fd,fd->f", normals, centres)
    cosine /= np.linalg.norm(normals, axis=1) * np.linalg.norm(centres, axis=1)
    # Stairs would turn normals up to 90°; the blurred slices leave a ripple.
    assert np.degrees(np.arccos(cosine.min())) < 20
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean() < 6


@pytest.mark.parametrize("mirrored", [False, True])
def test_oblique_anisotropic_ellipsoid_lands_in_the_right_millimetres(mirrored: bool) -> None:
    direction = Rotation.from_euler("xyz", [20, -35, 50], degrees=True).as_matrix()
    if mirrored:  # a left-handed image: legal, and turns triangles around if overlooked
        direction = direction @ np.diag([1.0, 1.0, -1.0])
    axes, centre = np.array([24.0, 16.0, 30.0]), (-40.0, 70.0, 300.0)

    def inside(points: np.ndarray) -> np.ndarray:
        held: np.ndarray = ((points / axes) ** 2).sum(axis=-1) <= 1
        return held

    mask = mask_of(inside, 34, (0.7, 1.1, 2.0), direction, centre)
    mesh, quality = mesh_with_quality(mask, COARSE)
    assert volume(mesh.vertices, mesh.faces) > 0
    assert quality.volume_ml == pytest.approx(4 / 3 * np.pi * axes.prod() / 1000, rel=0.01)
    # Sampling error of a centre over ten thousand voxels is far below a tenth of one.
    np.testing.assert_allclose(centroid(mesh.vertices, mesh.faces), centre, atol=0.1)
    level = np.linalg.norm((mesh.vertices - centre) / axes, axis=1)
    assert np.abs(level - 1).max() * axes.min() < 0.7


def test_storage_order_of_the_voxels_does_not_move_the_organ() -> None:
    mask = mask_of(lambda p: ball(15)(p) & (p[..., 0] < 4), 20, (1.0, 1.2, 1.5), centre=(5, 6, 7))
    flipped = Mask(
        mask.voxels[:, :, ::-1],
        mask.spacing_mm,
        mask.to_world(np.array([mask.voxels.shape[2] - 1.0, 0, 0])),
        mask.direction @ np.diag([-1.0, 1, 1]),
        "test",
    )
    first, _ = mesh_with_quality(mask, COARSE)
    second, _ = mesh_with_quality(flipped, COARSE)
    distances = closest_points(first.vertices, second.vertices, second.faces).distances
    assert distances.max() < 0.25  # grids of other phase round the sharp edge differently
    assert distances.mean() < 0.05


def test_the_largest_of_two_pieces_is_kept() -> None:
    both = mask_of(lambda p: ball(12)(p - [8, 0, 0]) | ball(6)(p - [-15, 0, 0]), 26)
    mesh, quality = mesh_with_quality(both, COARSE)
    np.testing.assert_allclose(centroid(mesh.vertices, mesh.faces), [8, 0, 0], atol=0.1)
    large = mask_of(lambda p: ball(12)(p - [8, 0, 0]), 26)
    assert quality.mask_volume_ml == pytest.approx(both.volume_mm3 / 1000)  # before cleaning
    assert quality.left_out_ml == pytest.approx((both.volume_mm3 - large.volume_mm3) / 1000)
    assert quality.pieces == 2
    assert quality.volume_ml == pytest.approx(large.volume_mm3 / 1000, rel=5e-4)
    assert quality.volume_change_percent == pytest.approx(
        100 * (large.volume_mm3 / both.volume_mm3 - 1), abs=0.05
    )
    assert quality.euler_number == 2


def test_cavities_are_filled() -> None:
    hollow, full = (
        mask_of(inside, 20) for inside in (lambda p: ball(15)(p) & ~ball(6)(p), ball(15))
    )
    _, quality = mesh_with_quality(hollow, COARSE)
    assert quality.mask_volume_ml == pytest.approx(hollow.volume_mm3 / 1000)
    cavity = full.volume_mm3 - hollow.volume_mm3
    assert quality.cavities_filled_ml == pytest.approx(cavity / 1000)
    assert quality.volume_ml == pytest.approx(full.volume_mm3 / 1000, rel=5e-4)


def test_a_torus_keeps_its_handle_or_loses_it_as_asked() -> None:
    mask = mask_of(torus(18, 6), 28)
    _, kept = mesh_with_quality(mask, MeshingSettings(faces=2000, cut_handles=False))
    assert (kept.euler_number, kept.handles_cut) == (0, 0)
    mesh, cut = mesh_with_quality(mask, COARSE)
    assert (cut.euler_number, cut.handles_cut) == (2, 1)
    assert is_oriented_manifold(mesh.faces)


def test_strong_smoothing_keeps_the_volume() -> None:
    _, quality = mesh_with_quality(
        mask_of(ball(10), 14), MeshingSettings(faces=1000, smoothing_mm=4.0, laplacian_steps=50)
    )
    assert quality.volume_change_percent == pytest.approx(0, abs=0.1)


def test_laplacian_steps_smooth_the_surface() -> None:
    """More steps leave smaller angles between neighbouring triangles."""

    def bend(steps: int) -> float:
        mesh, _ = mesh_with_quality(
            mask_of(ball(10), 14),
            MeshingSettings(faces=2000, smoothing_mm=0.3, laplacian_steps=steps),
        )
        surface = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        return float(surface.face_adjacency_angles.mean())

    assert bend(50) < 0.8 * bend(0)


def test_an_organ_on_the_image_border_is_closed() -> None:
    mask = mask_of(lambda p: p[..., 2] > -5, 12)
    _, quality = mesh_with_quality(mask, COARSE)
    assert (quality.euler_number, quality.boundary_loops) == (2, 0)


def test_moving_the_image_moves_the_mesh() -> None:
    mask = mask_of(ball(10), 14)
    moved = Mask(mask.voxels, mask.spacing_mm, mask.origin_mm - [-100, 0, 50], np.eye(3), "test")
    first, _ = mesh_with_quality(mask, COARSE)
    second, _ = mesh_with_quality(moved, COARSE)
    # Reduction runs in float32 and may choose other collapses far from the origin: same surface.
    distances = closest_points(
        second.vertices - [100, 0, -50], first.vertices, first.faces
    ).distances
    assert distances.max() < 0.15


def test_empty_mask_is_refused_by_name() -> None:
    empty = Mask(np.zeros((5, 5, 5), bool), np.ones(3), np.zeros(3), np.eye(3), "case_7")
    with pytest.raises(CaseError, match=r"case_7.*empty"):
        mesh_with_quality(empty, COARSE)


def test_a_grid_too_fine_for_memory_is_refused() -> None:
    with pytest.raises(CaseError, match=r"Raise meshing\.voxel_mm"):
        mesh_with_quality(mask_of(ball(20), 25), MeshingSettings(voxel_mm=0.01))


def test_sizes_follow_the_organ() -> None:
    lung, hippocampus = 2.4e6, 3.2e3
    assert grid_sizes(lung, MeshingSettings()) == (1.5, 2.0)
    voxel_mm, smoothing_mm = grid_sizes(hippocampus, MeshingSettings())
    assert voxel_mm < 0.5
    assert 0.5 < smoothing_mm < 1.0
    assert grid_sizes(lung, MeshingSettings(voxel_mm=3, smoothing_mm=1)) == (3, 1)

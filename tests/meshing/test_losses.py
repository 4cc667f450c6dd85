"""What a mesh lacks of its mask is measured, reported, and kept where it can be."""

import numpy as np
import pytest
from mask_shapes import ball, mask_of, torus
from scipy.spatial.transform import Rotation

from ssm_pipeline.geometry.topology import euler_number, is_oriented_manifold
from ssm_pipeline.meshing.losses import inside_mesh, lost_pieces
from ssm_pipeline.meshing.mask_to_mesh import mesh_with_quality
from ssm_pipeline.meshing.settings import MeshingSettings
from ssm_pipeline.records import Mask

FEW = MeshingSettings(faces=2000)
SMOOTHED = MeshingSettings(faces=2000, keep_thin_parts=False)
TIP = np.array([6.0, 8.0, 53.0])


def horned(seed: int) -> tuple[Mask, np.ndarray]:
    """An ellipsoid with a horn 33 mm long and two voxels thick, in any pose; and the horn's tip."""
    rotation = Rotation.random(random_state=seed).as_matrix()

    def inside(points: np.ndarray) -> np.ndarray:
        own = points @ rotation
        along = np.clip((own[..., 2] - 20) / 33, 0, 1)
        axis = np.stack([6 * along**2, 8 * along, 20 + 33 * along], -1)
        horn = (np.linalg.norm(own - axis, axis=-1) < 1) & (own[..., 2] > 15)
        held: np.ndarray = (((own / [8, 14, 20]) ** 2).sum(-1) < 1) | horn
        return held

    return mask_of(inside, 56), rotation @ TIP


def inside_by_definition(mask: Mask, radius: float) -> np.ndarray:
    z, y, x = np.indices(mask.voxels.shape)
    inside: np.ndarray = (mask.to_world(np.stack([x, y, z], -1)) ** 2).sum(-1) < radius**2
    return inside


def test_voxels_inside_the_mesh_of_an_oblique_image() -> None:
    direction = Rotation.from_euler("xyz", [20, -35, 50], degrees=True).as_matrix()
    mask = mask_of(ball(12), 16, (0.8, 1.1, 2.0), direction)
    mesh, _ = mesh_with_quality(mask, FEW)
    found = inside_mesh(mesh, mask)
    # The mesh is within a third of a voxel of the ball: the volumes of both bound it.
    assert (found | ~inside_by_definition(mask, 11.3)).all()
    assert (~found | inside_by_definition(mask, 12.7)).all()


@pytest.mark.parametrize("seed", range(2))
def test_a_horn_that_vanishes_is_reported(seed: int) -> None:
    mask, _ = horned(seed)
    _, quality = mesh_with_quality(mask, SMOOTHED)
    (warning,) = quality.warnings
    assert "the mesh lacks a part of" in warning
    assert "meshing.keep_thin_parts: true" in warning
    # 33 mm less what the blurred body reaches; the horn bends.
    assert 25 < quality.lost_piece_mm < 37
    assert quality.surface_max_mm >= quality.lost_piece_mm
    assert 0.05 < quality.lost_piece_ml < 33 * np.pi / 1000 * 1.3


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_a_horn_of_two_voxels_is_kept(seed: int) -> None:
    mask, tip = horned(seed)
    mesh, quality = mesh_with_quality(mask, FEW)
    assert np.linalg.norm(mesh.vertices - tip, axis=1).min() < 1.5
    assert quality.surface_max_mm < 2
    assert is_oriented_manifold(mesh.faces)
    assert euler_number(mesh.faces) == 2
    assert quality.volume_change_percent == pytest.approx(0, abs=0.05)
    (remark,) = quality.warnings
    assert "thin parts are kept by a grid of 0.5 mm" in remark


def test_the_volume_and_depth_of_a_lost_piece() -> None:
    """A mesh of a ball, and a mask with a bar beyond it: the bar is what is lost."""

    def bar(points: np.ndarray) -> np.ndarray:
        x, y, z = np.moveaxis(points, -1, 0)
        inside: np.ndarray = (np.abs(x) < 3) & (np.abs(y) < 3) & (z > 0) & (z < 30.5)
        return inside

    mesh, _ = mesh_with_quality(mask_of(ball(12), 32), FEW)
    whole = mask_of(lambda p: ball(12)(p) | bar(p), 32)
    (piece,) = lost_pieces(mesh, whole, 2.0)
    # Voxel centres from z = 15 (14 lies within 2 mm of the ball) to 30, 5 by 5 in a section.
    assert piece.volume_ml == pytest.approx(0.025 * 16, abs=0.026)
    assert piece.depth_mm == pytest.approx(18.2, abs=0.4)  # the corner (2, 2, 30) of radius 30.1
    np.testing.assert_allclose(piece.centre_mm, [0, 0, 22.5], atol=0.5)
    assert lost_pieces(mesh, mask_of(ball(12), 32), 2.0) == ()


def test_a_ring_cut_open_is_reported_with_its_place() -> None:
    _, quality = mesh_with_quality(mask_of(torus(18, 6), 28), FEW)
    (warning,) = quality.warnings
    assert "a bridge is cut at (" in warning
    assert "meshing.cut_handles: false keeps it" in warning
    place = np.array([float(v) for v in warning.split("(")[1].split(")")[0].split(",")])
    assert np.hypot(place[0], place[1]) == pytest.approx(18, abs=2)  # the middle of the tube
    assert place[2] == pytest.approx(0, abs=2)
    kept = mesh_with_quality(
        mask_of(torus(18, 6), 28), FEW.model_copy(update={"cut_handles": False})
    )
    assert kept[1].warnings == ()

"""The blurred field against the closed form, and the organ it starts from."""

import numpy as np
import pytest
from mask_shapes import ball, mask_of
from scipy.special import erf

from ssm_pipeline.meshing.mask_to_mesh import mesh_with_quality
from ssm_pipeline.meshing.organ import keep_organ
from ssm_pipeline.meshing.quick_mesh import quick_mesh
from ssm_pipeline.meshing.settings import MeshingSettings
from ssm_pipeline.meshing.smooth_field import smooth_field
from ssm_pipeline.records import CaseError, Mask


def test_a_box_blurs_to_products_of_error_functions() -> None:
    voxels = np.zeros((6, 12, 10), bool)
    voxels[1:5, 2:10, 1:9] = True
    spacing = np.array([1.0, 0.7, 2.0])
    mask = Mask(voxels, spacing, np.array([3.0, -4.0, 5.0]), np.eye(3), "box")
    sigma, step = 1.5, 0.9
    field = smooth_field(keep_organ(mask)[0], step, sigma)
    low = mask.origin_mm + (np.array([1, 2, 1]) - 0.5) * spacing
    high = mask.origin_mm + (np.array([9, 10, 5]) - 0.5) * spacing
    along = [
        0.5 * (erf((high[a] - x) / np.sqrt(2) / sigma) - erf((low[a] - x) / np.sqrt(2) / sigma))
        for a in range(3)
        for x in [field.origin_mm[a] + step * np.arange(field.values.shape[2 - a])]
    ]
    expected = np.einsum("x,y,z->zyx", *along)
    np.testing.assert_allclose(field.values, expected, atol=2e-6)  # float32, tails cut at 1e-7
    assert field.values.max() < 1
    assert max(field.values[0].max(), field.values[:, 0].max(), field.values[:, :, 0].max()) < 1e-3


def test_the_level_keeps_the_volume() -> None:
    organ, _ = keep_organ(mask_of(ball(9), 12))
    field = smooth_field(organ, 0.5, 3.0)
    kept = (field.values > field.level).sum() * field.voxel_mm**3
    assert abs(kept / organ.volume_mm3 - 1) < 1e-4
    assert abs((field.values > 0.5).sum() * field.voxel_mm**3 / organ.volume_mm3 - 1) > 0.05


def test_keep_organ_crops_without_moving() -> None:
    mask = mask_of(lambda p: ball(5)(p - [6, -3, 2]), 15, (1.0, 1.5, 2.0), centre=(10, 20, 30))
    organ, _ = keep_organ(mask)
    assert organ.voxels.size < mask.voxels.size
    for one in (mask, organ):
        centre = one.to_world(np.argwhere(one.voxels).mean(axis=0)[::-1])
        np.testing.assert_allclose(centre, [16, 17, 32], atol=1e-9)


@pytest.mark.parametrize("slice_mm", [5.0, 6.0, 8.0])
def test_the_grid_of_thick_slices_holds_the_whole_blur(slice_mm: float) -> None:
    """Sigma along thick slices exceeds smoothing_mm: the margin follows it, and no tip is cut."""
    organ, _ = keep_organ(
        mask_of(lambda p: ((p / [5, 7, 20.5]) ** 2).sum(-1) < 1, 24, (1, 1, slice_mm))
    )
    field = smooth_field(organ, 0.5, 0.7)
    for axis in range(3):
        ends = np.take(field.values, [0, -1], axis=axis)
        assert ends.max() < 1e-3 < 0.2 < field.level


@pytest.mark.parametrize("slice_mm", [6.0, 8.0])
def test_an_organ_of_three_millilitres_in_thick_slices_is_meshed(slice_mm: float) -> None:
    mask = mask_of(lambda p: ((p / [5, 7, 20.5]) ** 2).sum(-1) < 1, 24, (1, 1, slice_mm))
    mesh, quality = mesh_with_quality(mask, MeshingSettings(faces=1000))
    half_mm = np.abs(mesh.vertices[:, 2]).max()
    voxels = np.nonzero(mask.voxels.any(axis=(1, 2)))[0]
    covered_mm = (voxels[-1] - voxels[0] + 1) * slice_mm / 2  # of the outermost slices' faces
    assert covered_mm - slice_mm < half_mm < covered_mm + 0.5 * slice_mm
    assert quality.volume_change_percent == pytest.approx(0, abs=0.05)


def test_meshes_of_thin_slices_are_not_changed_by_the_margin() -> None:
    """Where smoothing_mm is the sigma of every axis, the grid is 4 sigma and two voxels wider."""
    organ, _ = keep_organ(mask_of(ball(9), 12))
    field = smooth_field(organ, 0.5, 2.0)
    extent = (organ.voxels.shape[0] - 1) * 1.0
    assert field.values.shape[0] == int(np.ceil((extent + 2 * (8 + 1)) / 0.5)) + 1


def test_a_grid_too_coarse_for_the_organ_names_the_unit() -> None:
    """Masks in metres: the grid has no point in the organ."""
    small = mask_of(ball(9), 12)
    metres = Mask(small.voxels, small.spacing_mm / 1000, small.origin_mm, np.eye(3), "case_7")
    with pytest.raises(CaseError, match=r"case_7: .*too coarse.*data\.unit"):
        mesh_with_quality(metres, MeshingSettings(faces=1000, voxel_mm=0.1))
    with pytest.raises(CaseError, match=r"case_7"):
        mesh_with_quality(metres, MeshingSettings(faces=1000, voxel_mm=0.1, smoothing_mm=1.0))
    # Without a length in the settings, sizes follow the organ, however small.
    for unit in (1e-3, 1e-2, 1e3):
        other = Mask(small.voxels, small.spacing_mm * unit, small.origin_mm, np.eye(3), "case_7")
        mesh, _ = quick_mesh(other, MeshingSettings())
        assert np.ptp(mesh.vertices[:, 2]) == pytest.approx(18.5 * unit, rel=0.1)

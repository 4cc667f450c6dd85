"""The blurred field against the closed form, and the organ it starts from."""

import numpy as np
from mask_shapes import ball, mask_of
from scipy.special import erf

from ssm_pipeline.meshing.organ import keep_organ
from ssm_pipeline.meshing.smooth_field import smooth_field
from ssm_pipeline.records import Mask


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

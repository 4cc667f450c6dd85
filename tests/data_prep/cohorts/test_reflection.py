"""The mirror image of an oblique mask, voxel by voxel."""

import numpy as np
from scipy.spatial.transform import Rotation

from ssm_pipeline.data_prep.cohorts.sides import reflect
from ssm_pipeline.records import Mask


def test_every_voxel_of_an_oblique_mask_is_reflected_across_x() -> None:
    direction = Rotation.from_euler("zyx", [25, -15, 40], degrees=True).as_matrix()
    voxels = np.zeros((5, 6, 7), bool)
    voxels[1:3, 2:5, 1:6] = True
    mask = Mask(voxels, np.array([0.7, 0.9, 2.5]), np.array([-30.0, 12, 200]), direction, "a")
    index = np.argwhere(voxels)[:, ::-1].astype(float)
    reflected = reflect(mask)
    assert isinstance(reflected, Mask)
    np.testing.assert_allclose(
        reflected.to_world(index), mask.to_world(index) * [-1, 1, 1], atol=1e-12
    )

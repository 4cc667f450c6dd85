import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ssm_pipeline.geometry.affine import affine_share


def cloud(count: int = 400) -> np.ndarray:
    return np.random.default_rng(1).uniform(-1, 1, (count, 3)) * [40, 60, 100]


def test_affine_shapes_in_any_pose_are_affine_to_the_last_digit() -> None:
    points, generator = cloud(), np.random.default_rng(0)
    shapes = np.stack(
        [
            points @ (np.eye(3) + 0.1 * generator.standard_normal((3, 3))).T
            @ Rotation.random(rng=generator).as_matrix().T
            + 50 * generator.standard_normal(3)
            for _ in range(6)
        ]
    )  # fmt: skip
    assert affine_share(shapes) == pytest.approx(1, abs=1e-6)


def test_noise_is_affine_by_its_degrees_of_freedom_alone() -> None:
    # Independent noise at V points has 3V dimensions, of which an affine map explains 12, the six
    # of pose having been taken out: 6 of 3V − 6.
    points = cloud(100)
    shapes = points + 0.01 * np.random.default_rng(2).standard_normal((200, 100, 3))
    assert affine_share(shapes) == pytest.approx(6 / 294, rel=0.15)


def test_half_and_half() -> None:
    # Along z, x and (x² − mean) have known variances and are uncorrelated on a symmetric cloud.
    points = cloud(20_000)
    points = np.concatenate([points, points * [-1, 1, 1]])
    x = points[:, 0] / 40
    square = x**2 - (x**2).mean()
    stretch = np.outer(points[:, 2] / points[:, 2].std(), [0, 0, 1.0])
    bend = np.outer(square / square.std(), [0, 0, 1.0])
    signs = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)])
    shapes = points + 0.05 * np.einsum("nk,kvd->nvd", signs, np.stack([stretch, bend]))
    assert affine_share(shapes) == pytest.approx(0.5, abs=0.01)


def test_shapes_that_do_not_differ_are_refused() -> None:
    with pytest.raises(ValueError, match="do not differ"):
        affine_share(np.stack([cloud()] * 3))

"""What cleaning a mask leaves out is told, and measured on the mask as it was."""

import dataclasses

import numpy as np
import pytest
from mask_shapes import ball, mask_of

from ssm_pipeline.meshing.organ import keep_organ


def test_two_organs_of_one_size_under_one_label() -> None:
    both = mask_of(lambda p: ball(8)(p - [12, 0, 0]) | ball(8)(p - [-12, 0, 0]), 24)
    organ, cleaning = keep_organ(both)
    assert organ.volume_mm3 == pytest.approx(both.volume_mm3 / 2)
    assert (cleaning.pieces, cleaning.given) == (2, both.volume_mm3)
    (warning,) = cleaning.warnings
    assert "holds 2 pieces; all but the largest, 50 %" in warning
    assert "100 % as large as the first: two organs under one label?" in warning


def test_a_crumb_is_no_second_organ() -> None:
    mask = mask_of(lambda p: ball(10)(p) | ball(3)(p - [16, 0, 0]), 22)
    (warning,) = keep_organ(mask)[1].warnings
    assert "all but the largest, 3 %" in warning
    assert "two organs" not in warning


def test_a_long_thin_streak_is_not_the_organ() -> None:
    def both(points: np.ndarray) -> np.ndarray:
        streak = np.ptp(points, axis=-1) < 0.1  # the diagonal of the image
        organ: np.ndarray = ball(7)(points - [14, -14, 10]) | streak
        return organ

    mask = mask_of(both, 24)
    organ, cleaning = keep_organ(mask)
    assert cleaning.pieces == 2
    assert organ.volume_mm3 == pytest.approx(4 / 3 * np.pi * 7**3, rel=0.02)


def test_a_filled_cavity_is_told() -> None:
    _, cleaning = keep_organ(mask_of(lambda p: ball(15)(p) & ~ball(8)(p), 20))
    assert cleaning.filled == pytest.approx(4 / 3 * np.pi * 8**3, rel=0.02)  # a voxelised ball
    (warning,) = cleaning.warnings
    assert "cavities of 2.1" in warning
    assert "(18 % of it) are filled" in warning  # of the hollow organ: 512 / (3375 - 512)


def test_a_plain_organ_has_nothing_to_tell() -> None:
    _, cleaning = keep_organ(mask_of(ball(10), 14))
    assert cleaning.warnings == ()
    assert (cleaning.left_out, cleaning.filled) == (0, 0)


def test_the_largest_piece_has_the_most_voxels_not_the_largest_box() -> None:
    """A thin streak across the image beside a ball: the ball is the organ."""
    ball_only = mask_of(ball(10), 30)
    voxels = ball_only.voxels.copy()
    z = np.arange(40)
    voxels[z, z, 60 - z] = True
    voxels[18:45, 18:45, 18:45] = ball_only.voxels[18:45, 18:45, 18:45]
    organ, cleaning = keep_organ(dataclasses.replace(ball_only, voxels=voxels))
    assert cleaning.pieces > 1
    assert organ.volume_mm3 == ball_only.volume_mm3

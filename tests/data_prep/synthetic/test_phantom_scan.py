"""Voxels of solids whose volume, labels and holes are known."""

import numpy as np
import pytest
import trimesh
from scipy import ndimage
from skimage.measure import euler_number

from ssm_pipeline.data_prep.synthetic.phantom_scan import (
    Handle,
    Slab,
    grid_around,
    occupancy,
    segmented,
    two_labels,
)

BALL = trimesh.creation.icosphere(4, radius=20.0)
VERTICES, FACES = np.array(BALL.vertices), np.array(BALL.faces)
SPACING = (1.0, 1.0, 3.0)
CELL = float(np.prod(SPACING))


def test_occupancy_sums_to_the_volume_and_lies_between() -> None:
    grid = grid_around(VERTICES, SPACING, np.array([0.3, 0.7, 0.1]))
    share = occupancy(VERTICES, FACES, grid)
    # Eight or more samples a voxel along a smooth border: errors cancel to a part in a thousand.
    assert share.sum() * CELL == pytest.approx(BALL.volume, rel=2e-3)
    assert share.min() == 0
    assert share.max() == 1
    assert ((share > 0.2) & (share < 0.8)).sum() > 500
    z = grid.axes()[2]
    centre = (share.sum(axis=(1, 2)) * z).sum() / share.sum()
    assert centre == pytest.approx(0, abs=0.02)


def test_noise_stays_at_the_border_and_leaves_the_volume() -> None:
    grid = grid_around(VERTICES, SPACING, np.zeros(3))
    share = occupancy(VERTICES, FACES, grid)
    quiet = segmented(share, grid, (), 0.0, np.random.default_rng(0))
    noisy = segmented(share, grid, (), 0.3, np.random.default_rng(0))
    flipped = quiet != noisy
    assert 100 < flipped.sum() < 0.1 * quiet.sum()
    deep = ndimage.distance_transform_edt(quiet, sampling=SPACING[::-1]) > 4.5
    far = ndimage.distance_transform_edt(~quiet, sampling=SPACING[::-1]) > 4.5
    assert not flipped[deep | far].any()
    assert noisy.sum() * CELL == pytest.approx(BALL.volume, rel=0.02)


@pytest.mark.parametrize("is_bridge", [True, False])
def test_a_bridge_and_a_tunnel_each_make_one_handle(is_bridge: bool) -> None:
    grid = grid_around(VERTICES, (1.0, 1.0, 1.0), np.zeros(3) + 12)
    share = occupancy(VERTICES, FACES, grid)
    outward = -12.0 if is_bridge else 12.0
    path = np.array([[0.0, -18, 9], [0, -19 + outward, 0], [0, -18, -9]])
    handle = Handle(path, 2.5, is_bridge)
    solid = segmented(share, grid, (handle,), 0.0, np.random.default_rng(0))
    assert euler_number(segmented(share, grid, (), 0.0, np.random.default_rng(0)), 3) == 1
    assert euler_number(solid, connectivity=3) == 0


def test_labels_meet_at_the_border() -> None:
    grid = grid_around(VERTICES, (1.0, 1.0, 1.0), np.full(3, 0.5))
    voxels = occupancy(VERTICES, FACES, grid) > 0.5
    labels = two_labels(voxels, grid, VERTICES, VERTICES[:, 1] - 6.0)
    assert ((labels > 0) == voxels).all()
    z, y, x = np.meshgrid(*grid.axes()[::-1], indexing="ij")
    # At the surface the border is the plane y = 6; within, the nearest vertex decides.
    near = voxels & (np.sqrt(x**2 + y**2 + z**2) > 17)
    right = labels == np.where(y < 6, 1, 2)
    assert right[near & (np.abs(y - 6) > 1.5)].all()


def test_a_cut_view_keeps_the_slices_between() -> None:
    whole = grid_around(VERTICES, SPACING, np.zeros(3))
    cut = Slab(low_mm=-10.0).within(whole)
    z = cut.axes()[2]
    assert z[0] >= -10 > z[0] - 3
    assert z[-1] == pytest.approx(whole.axes()[2][-1])
    shown = Slab(low_mm=-10.0).holds(VERTICES)
    assert shown.mean() == pytest.approx(0.75, abs=0.02)  # a cap of 10 of 40 mm: a quarter
    assert occupancy(VERTICES, FACES, cut)[0].max() == 1  # the organ reaches the first slice
    assert Slab().holds(VERTICES).all()

"""Labels of voxels on the surface: borders where they were, and smooth."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from ssm_pipeline.meshing.mask_to_mesh import mesh_with_quality
from ssm_pipeline.meshing.settings import MeshingSettings
from ssm_pipeline.meshing.surface_labels import surface_labels
from ssm_pipeline.records import CaseError, Mask


def tube(
    border: float, spacing: tuple[float, float, float] = (1.0, 1.0, 1.0), slant: float = 0.0
) -> Mask:
    """A tube along y of radius 6 mm and 40 mm, label 4 before y + slant x = border, 7 beyond."""
    shape = [int(length / s) for length, s in zip((20, 50, 20), spacing, strict=True)]
    x, y, z = (
        np.arange(n) * s - offset for n, s, offset in zip(shape, spacing, (10, 5, 10), strict=True)
    )
    z, y, x = np.meshgrid(z, y, x, indexing="ij")
    inside = (x**2 + z**2 < 36) & (y >= 0) & (y < 40)
    labels = np.where(inside, np.where(y + slant * x < border, 4, 7), 0)
    origin = np.array([-10.0, -5, -10])
    return Mask(inside, np.array(spacing), origin, np.eye(3), "tube", labels=labels)


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.8, 0.8, 2.0)])
def test_the_border_is_between_the_voxels_of_either_side(spacing: Any) -> None:
    mask = tube(20.0, spacing)
    mesh, _ = mesh_with_quality(dataclasses.replace(mask, labels=None), MeshingSettings(faces=3000))
    found = surface_labels(mesh, mask)
    np.testing.assert_array_equal(found.values, [4, 7])
    np.testing.assert_allclose(found.shares.sum(axis=1), 1, atol=1e-6)
    y = mesh.vertices[:, 1]
    # Voxel centres lie at … 19, 20 …: the border runs halfway between the last 4 and the first 7.
    rows = np.unique(np.arange(0, 50, spacing[1]) - 5)
    border = (rows[rows < 20].max() + rows[rows >= 20].min()) / 2
    assert (found.labels[y < border - 0.3] == 4).all()
    assert (found.labels[y > border + 0.3] == 7).all()
    assert ((found.shares > 0.05) & (found.shares < 0.95)).any()  # it fades, over about a voxel


def test_a_slanted_border_keeps_its_axes() -> None:
    mask = tube(20.0, slant=0.8)
    mesh, _ = mesh_with_quality(dataclasses.replace(mask, labels=None), MeshingSettings(faces=2000))
    found = surface_labels(mesh, mask)
    ahead = mesh.vertices[:, 1] + 0.8 * mesh.vertices[:, 0] - 19.5
    assert (found.labels[ahead < -1] == 4).all()  # a voxel's stair
    assert (found.labels[ahead > 1] == 7).all()


def test_a_vertex_far_from_all_voxels_has_the_nearest_ones_label() -> None:
    mask = tube(20.0)
    mesh, _ = mesh_with_quality(dataclasses.replace(mask, labels=None), MeshingSettings(faces=1000))
    moved = dataclasses.replace(mesh, vertices=mesh.vertices + np.array([0, 300.0, 0]))
    assert (surface_labels(moved, mask).labels == 7).all()


def test_a_mask_without_labels_is_refused() -> None:
    mask = dataclasses.replace(tube(20.0), labels=None)
    mesh, _ = mesh_with_quality(mask, MeshingSettings(faces=500))
    with pytest.raises(CaseError, match="no labels of parts"):
        surface_labels(mesh, mask)

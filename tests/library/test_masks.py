"""`read_mask` and `mesh_from_mask`: masks from files and arrays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk

import ssm_pipeline as ssm

SPACING, ORIGIN = (1.0, 2.0, 3.0), (10.0, -20.0, 30.0)
TURNED = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])


def labels() -> np.ndarray:
    z, y, x = np.indices((20, 24, 40))
    inside = ((z - 9) / 6) ** 2 + ((y - 11) / 7) ** 2 + ((x - 18) / 12) ** 2 < 1
    return np.where(inside, np.where(x > 18, 3, 7), 0).astype(np.uint8)


def test_an_array_and_a_file_of_the_same_content_give_the_same_mask(tmp_path: Path) -> None:
    image = sitk.GetImageFromArray(labels())
    image.SetSpacing(SPACING)
    image.SetOrigin(ORIGIN)
    image.SetDirection(TURNED.ravel())
    path = tmp_path / "liver_7.nii.gz"
    sitk.WriteImage(image, str(path))
    read = ssm.read_mask(path, labels=[3, 7])
    made = ssm.read_mask(labels(), [3, 7], spacing_mm=SPACING, origin_mm=ORIGIN, direction=TURNED)
    assert (read.case_id, made.case_id) == ("liver_7", "array")
    np.testing.assert_array_equal(read.voxels, made.voxels)
    for index in ([0, 0, 0], [5, 9, 2]):  # NIfTI's header is in single precision
        np.testing.assert_allclose(
            read.to_world(np.array(index)), made.to_world(np.array(index)), atol=1e-4
        )
    # Voxel x = 1 lies one spacing along the first column of the direction.
    step = made.to_world(np.array([1, 0, 0])) - made.to_world(np.zeros(3))
    np.testing.assert_allclose(step, [0, 1, 0])


def test_a_label_must_be_named_where_there_are_several() -> None:
    with pytest.raises(ssm.CaseError, match=r"2 labels \(3, 7\); which is the organ"):
        ssm.read_mask(labels(), spacing_mm=SPACING)
    assert ssm.read_mask(labels() > 3, spacing_mm=SPACING).voxels.sum() == (labels() > 3).sum()
    one = ssm.read_mask(labels(), 3, spacing_mm=SPACING)
    np.testing.assert_array_equal(one.voxels, labels() == 3)
    certain = ssm.read_mask(labels() / 7.0, threshold=0.5, spacing_mm=SPACING)
    np.testing.assert_array_equal(certain.voxels, labels() == 7)


def test_arrays_of_another_shape_are_refused() -> None:
    with pytest.raises(ssm.CaseError, match=r"shape \(4, 4\); \(Z, Y, X\) is needed"):
        ssm.read_mask(np.ones((4, 4)), spacing_mm=SPACING)
    with pytest.raises(ssm.CaseError, match=r"spacing_mm has shape \(2,\)"):
        ssm.read_mask(labels() > 0, spacing_mm=(1, 1))
    with pytest.raises(ssm.CaseError, match="not at right angles"):
        ssm.read_mask(labels() > 0, spacing_mm=SPACING, direction=np.ones((3, 3)))


def test_the_surface_has_the_volume_of_the_mask_and_lies_where_it_lies() -> None:
    mask = ssm.read_mask(labels() > 0, spacing_mm=SPACING, origin_mm=ORIGIN, case_id="a")
    mesh = ssm.mesh_from_mask(mask, ssm.MeshingSettings(faces=800))
    from ssm_pipeline.geometry.surface import volume

    assert mesh.case_id == "a"
    assert len(mesh.faces) == 800
    assert volume(mesh.vertices, mesh.faces) == pytest.approx(mask.volume_mm3, rel=0.01)
    middle = mask.to_world(np.argwhere(mask.voxels)[:, ::-1].mean(axis=0))
    np.testing.assert_allclose(mesh.vertices.mean(axis=0), middle, atol=1.0)  # a third of a voxel

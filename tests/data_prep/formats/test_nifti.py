"""NIfTI files that SimpleITK refuses or places differently, written by nibabel."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import pytest

from ssm_pipeline.data_prep.formats.images import read_labels, read_organ
from ssm_pipeline.records import CaseError

LABELS = np.zeros((14, 12, 10), np.uint8)
LABELS[3:12, 2:9, 1:8] = 1
LABELS[5:7, 4:6, 3:5] = 2
RAS = np.array([[1.6, 0, 0, -12], [0, 1.6, 0, -9], [0, 0, 2.0, 7], [0, 0, 0, 1.0]])
INDEX = np.array([[0.0, 0, 0], [4, 5, 6]])


def written(
    path: Path,
    sform: Any = RAS,
    qform: Any = None,
    codes: Any = (1, 0),
    kind: Any = nibabel.Nifti1Image,
) -> Path:
    image = kind(LABELS, sform)
    image.set_sform(sform, codes[0])
    image.set_qform(sform if qform is None else qform, codes[1])
    nibabel.save(image, path)
    return path


def moved(*offset: float) -> np.ndarray:
    other = RAS.copy()
    other[:3, 3] += offset
    return other


def in_lps(affine: np.ndarray) -> np.ndarray:
    points: np.ndarray = (INDEX @ affine[:3, :3].T + affine[:3, 3]) * [-1, -1, 1]
    return points


def test_a_slightly_skewed_sform_is_read(tmp_path: Path) -> None:
    skewed = RAS.copy()
    skewed[0, 1] += 4.8e-4  # 0.02 degrees
    mask = read_organ(written(tmp_path / "a.nii.gz", skewed), (1, 2), "a")
    np.testing.assert_array_equal(mask.labels, LABELS.T)
    np.testing.assert_allclose(mask.to_world(INDEX), in_lps(skewed), atol=1e-2)
    assert mask.warnings == ()
    skewed[0, 1] += 0.05
    with pytest.raises(CaseError, match=r"right angles \(off by 1\.8 degrees\)"):
        read_organ(written(tmp_path / "b.nii.gz", skewed), (1,), "b")


def test_of_two_forms_the_sform_places_the_image_and_the_difference_is_reported(
    tmp_path: Path,
) -> None:
    path = written(tmp_path / "a.nii.gz", RAS, moved(0, 25, 0), codes=(1, 1))
    mask = read_organ(path, (1,), "a")
    np.testing.assert_allclose(mask.to_world(INDEX), in_lps(RAS), atol=1e-4)
    (warning,) = mask.warnings
    assert "the sform and the qform of a.nii.gz put the image up to 25 mm apart" in warning
    for offset, codes in (((0, 0, 0), (1, 1)), ((0, 0.1, 0), (1, 1)), ((0, 25, 0), (1, 0))):
        path = written(tmp_path / "b.nii", RAS, moved(*offset), codes)
        mask = read_organ(path, (1,), "b")
        assert mask.warnings == ()
        np.testing.assert_allclose(mask.to_world(INDEX), in_lps(RAS), atol=1e-4)


def test_forms_that_differ_in_size_or_handedness_are_refused(tmp_path: Path) -> None:
    mirrored, larger = RAS @ np.diag([-1, 1, 1, 1]), RAS @ np.diag([1, 1, 1.1, 1])
    with pytest.raises(CaseError, match="mirror images of each other"):
        read_organ(written(tmp_path / "a.nii", RAS, mirrored, codes=(1, 1)), (1,), "a")
    path = written(tmp_path / "a.nii", RAS, larger, codes=(1, 1))
    header = nibabel.Nifti1Image.from_filename(path).header
    header.set_sform(RAS, 1)
    nibabel.save(nibabel.Nifti1Image(LABELS, None, header), path)
    with pytest.raises(CaseError, match=r"voxels of 1\.6 × 1\.6 × 2 mm.*different voxel sizes"):
        read_organ(path, (1,), "a")


@pytest.mark.parametrize("kind", [nibabel.Nifti1Image, nibabel.Nifti2Image])
def test_the_content_says_whether_it_is_compressed(tmp_path: Path, kind: type) -> None:
    plain = written(tmp_path / "plain.nii", kind=kind)
    good = read_labels(plain, "a")
    (tmp_path / "a.nii.gz").write_bytes(plain.read_bytes())
    (tmp_path / "b.nii").write_bytes(gzip.compress(plain.read_bytes()))
    for name in ("a.nii.gz", "b.nii"):
        other = read_labels(tmp_path / name, "a")
        np.testing.assert_array_equal(other.labels, good.labels)
        np.testing.assert_array_equal(other.labels, LABELS.T)
        np.testing.assert_allclose(other.origin_mm, good.origin_mm)
        np.testing.assert_allclose(
            other.direction * other.spacing_mm, good.direction * [1.6, 1.6, 2]
        )


def test_a_nifti_2_file_cut_short_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "a.nii", kind=nibabel.Nifti2Image)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(CaseError, match="damaged or cut short"):
        read_organ(path, (1,), "a")


@pytest.mark.parametrize("off", [3e-5, -4e-4])
def test_labels_that_are_nearly_whole_are_rounded_with_a_warning(
    tmp_path: Path, off: float
) -> None:
    path = tmp_path / "a.nii.gz"
    nibabel.save(nibabel.Nifti1Image(LABELS * np.float32(1 + off), RAS), path)
    mask = read_organ(path, (1, 2), "a")
    np.testing.assert_array_equal(mask.labels, LABELS.T)
    (warning,) = mask.warnings
    assert f"{np.count_nonzero(LABELS)} voxels hold labels such as" in warning
    nibabel.save(nibabel.Nifti1Image(LABELS * np.float32(1.002), RAS), path)
    with pytest.raises(CaseError, match="between whole numbers"):
        read_organ(path, (1,), "a")


def test_voxels_equal_to_the_threshold_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "a.nii.gz"
    nibabel.save(nibabel.Nifti1Image(LABELS.astype(np.float32) / 2, RAS), path)
    mask = read_organ(path, (1,), "a", threshold=0.25)
    np.testing.assert_array_equal(mask.voxels, LABELS.T > 0)
    with pytest.raises(CaseError, match=r"8 voxel\(s\)"):
        read_organ(path, (1,), "a", threshold=0.5)  # those of label 2 alone

"""Label images: right millimetres, and an error that names the case for each kind of bad file."""

import gzip
import struct
from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk
from scipy.spatial.transform import Rotation

from ssm_pipeline.data_prep.formats.images import read_labels, read_organ
from ssm_pipeline.data_prep.formats.organ_size import MM_OF, Unit
from ssm_pipeline.records import CaseError

SUFFIXES = ["mhd", "mha", "nrrd", "nii", "nii.gz"]


def labels_with_box(label: int = 1) -> np.ndarray:
    labels = np.zeros((20, 24, 28), np.uint8)
    labels[5:15, 6:18, 4:20] = label
    return labels


def write(path: Path, labels: np.ndarray, spacing: tuple[float, ...] = (1.0, 1.0, 1.0)) -> Path:
    image = sitk.GetImageFromArray(labels)
    image.SetSpacing(spacing)
    sitk.WriteImage(image, str(path), useCompression=True)
    return path


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_oblique_anisotropic_image_in_every_format(tmp_path: Path, suffix: str) -> None:
    direction = Rotation.from_euler("zyx", [25, -15, 40], degrees=True).as_matrix()
    labels = np.zeros((20, 24, 28), np.uint8)
    labels[3:9, 10:20, 5:15] = 2
    image = sitk.GetImageFromArray(labels)
    image.SetSpacing((0.6, 0.9, 2.5))
    image.SetOrigin((-30.0, 12.0, 200.0))
    image.SetDirection(direction.ravel().tolist())
    path = tmp_path / f"a.{suffix}"
    sitk.WriteImage(image, str(path), useCompression=suffix != "nii")
    mask = read_organ(path, (2,), "a")
    np.testing.assert_array_equal(mask.voxels, labels == 2)
    corner = np.array([5, 10, 3])
    expected = np.array([-30.0, 12.0, 200.0]) + direction @ (corner * [0.6, 0.9, 2.5])
    # NIfTI keeps its matrix in float32.
    np.testing.assert_allclose(mask.to_world(corner), expected, atol=1e-4)
    np.testing.assert_allclose(
        mask.to_world(corner), image.TransformIndexToPhysicalPoint(corner.tolist()), atol=1e-4
    )
    assert mask.volume_mm3 == pytest.approx(600 * 0.6 * 0.9 * 2.5, rel=1e-5)
    assert mask.warnings == ()


def test_labels_are_united(tmp_path: Path) -> None:
    labels = labels_with_box(1)
    labels[15:18, 6:18, 4:20] = 2
    labels[0, 0, 0] = 7
    path = write(tmp_path / "a.nii.gz", labels)
    np.testing.assert_array_equal(
        read_organ(path, (1, 2), "a").voxels, (labels == 1) | (labels == 2)
    )


def test_labels_stored_as_floats(tmp_path: Path) -> None:
    path = write(tmp_path / "a.nrrd", labels_with_box(3).astype(np.float32))
    assert read_organ(path, (3,), "a").voxels.sum() == 10 * 12 * 16


def test_absent_label_lists_those_found(tmp_path: Path) -> None:
    labels = labels_with_box(3)
    labels[0, 0, :4] = 5
    path = write(tmp_path / "a.nrrd", labels)
    with pytest.raises(CaseError, match=r"case a: the lung \(label 4\) is absent.*found: 3, 5"):
        read_organ(path, (4,), "a", organ="lung")


def test_one_of_several_labels_is_absent(tmp_path: Path) -> None:
    path = write(tmp_path / "a.nrrd", labels_with_box(1))
    with pytest.raises(CaseError, match=r"the heart's label 2 is absent; labels found: 1"):
        read_organ(path, (1, 2), "a", organ="heart")


def test_empty_mask(tmp_path: Path) -> None:
    path = write(tmp_path / "a.nrrd", np.zeros((9, 9, 9), np.uint8))
    with pytest.raises(CaseError, match="the mask is empty"):
        read_organ(path, (1,), "a")


def test_one_voxel_organ(tmp_path: Path) -> None:
    labels = np.zeros((9, 9, 9), np.uint8)
    labels[4, 4, 4] = 1
    path = write(tmp_path / "a.nrrd", labels)
    with pytest.raises(CaseError, match=r"holds 1 voxel\(s\); at least 64"):
        read_organ(path, (1,), "a")


def test_border_contact_is_a_warning_or_a_refusal(tmp_path: Path) -> None:
    labels = labels_with_box()
    labels[0:5, 6:18, 4:20] = 1
    labels[5:15, 6:18, 20:] = 1
    path = write(tmp_path / "a.nii.gz", labels)
    (warning,) = read_organ(path, (1,), "a", organ="liver").warnings
    assert "liver (label 1) touches the image border on 2 border slices" in warning
    assert "first z: 192 voxels, last x: 120 voxels" in warning
    with pytest.raises(CaseError, match=r"touches the image border on 2.*cut off"):
        read_organ(path, (1,), "a", allow_truncated=False)


@pytest.mark.parametrize("shape", [(20, 20), (2, 12, 12, 12)])
def test_not_3d(tmp_path: Path, shape: tuple[int, ...]) -> None:
    image = sitk.GetImageFromArray(np.ones(shape, np.uint8), isVector=False)
    path = tmp_path / "a.nii.gz"
    sitk.WriteImage(image, str(path))
    with pytest.raises(CaseError, match="one 3D volume of labels is needed"):
        read_organ(path, (1,), "a")


def test_colour_image(tmp_path: Path) -> None:
    path = tmp_path / "a.nrrd"
    sitk.WriteImage(sitk.GetImageFromArray(np.ones((9, 9, 9, 3), np.uint8), isVector=True), path)
    with pytest.raises(CaseError, match=r"3 value\(s\) per voxel"):
        read_organ(path, (1,), "a")


def noise() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 4, (20, 30, 40)).astype(np.uint8)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("share", [0.6, 0.0])
def test_file_cut_short(tmp_path: Path, suffix: str, share: float) -> None:
    path = write(tmp_path / f"a.{suffix}", noise())
    data = path.with_suffix(".zraw") if suffix == "mhd" else path
    data.write_bytes(data.read_bytes()[: int(share * data.stat().st_size)])
    with pytest.raises(CaseError, match="case scan_1: "):
        read_organ(path, (1,), "scan_1")


@pytest.mark.parametrize("suffix", ["mhd", "mha", "nrrd", "nii.gz"])
def test_damaged_byte(tmp_path: Path, suffix: str) -> None:
    path = write(tmp_path / f"a.{suffix}", noise())
    data = path.with_suffix(".zraw") if suffix == "mhd" else path
    content = bytearray(data.read_bytes())
    content[len(content) // 2] ^= 0xFF
    data.write_bytes(content)
    with pytest.raises(CaseError, match="case scan_1: "):
        read_organ(path, (1,), "scan_1")


@pytest.mark.parametrize("bad", ["nan 1 1", "0 1 1", "inf 1 1", "x 1 1"])
def test_metaimage_spacing(tmp_path: Path, bad: str) -> None:
    path = write(tmp_path / "a.mhd", labels_with_box())
    lines = path.read_text().splitlines()
    lines = [f"ElementSpacing = {bad}" if line.startswith("ElementSp") else line for line in lines]
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(CaseError, match=r"voxel spacing .* finite, non-zero"):
        read_organ(path, (1,), "a")


@pytest.mark.parametrize("bad", [float("nan"), 0.0, float("inf")])
def test_nifti_spacing(tmp_path: Path, bad: float) -> None:
    path = write(tmp_path / "a.nii.gz", labels_with_box())
    content = bytearray(gzip.decompress(path.read_bytes()))
    content[80:84] = struct.pack("<f", bad)
    path.write_bytes(gzip.compress(bytes(content)))
    with pytest.raises(CaseError, match=r"voxel spacing .* finite, non-zero"):
        read_organ(path, (1,), "a")


def test_header_without_its_data(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mhd", labels_with_box())
    (tmp_path / "a.zraw").unlink()
    with pytest.raises(CaseError, match=r"names the data file a\.zraw, which is not beside it"):
        read_organ(path, (1,), "a")


def test_a_data_file_with_a_name_that_is_not_ascii(tmp_path: Path) -> None:
    path = write(tmp_path / "Fall Nr. 4 – é.mhd", labels_with_box())
    assert read_organ(path, (1,), "a").voxels.sum() == 10 * 12 * 16


def test_not_an_image_and_no_file(tmp_path: Path) -> None:
    path = tmp_path / "a.nrrd"
    path.write_text("not an image")
    with pytest.raises(CaseError, match=r"case a: a\.nrrd can't be read"):
        read_organ(path, (1,), "a")
    with pytest.raises(CaseError, match="there is no file"):
        read_organ(tmp_path / "b.nrrd", (1,), "b")


def nifti_with(path: Path, fields: dict[int, bytes]) -> Path:
    """The oblique box of `labels_with_box` as NIfTI, bytes of its header replaced."""
    image = sitk.GetImageFromArray(labels_with_box())
    image.SetSpacing((1.0, 2.0, 3.0))
    image.SetOrigin((5.0, 6.0, 7.0))
    direction = Rotation.from_euler("zyx", [25, -15, 40], degrees=True).as_matrix()
    image.SetDirection(direction.ravel().tolist())
    sitk.WriteImage(image, str(path))
    content = bytearray(path.read_bytes())
    for start, new in fields.items():
        content[start : start + len(new)] = new
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("codes", [(1, 1), (0, 1), (1, 0), (0, 2)])
@pytest.mark.parametrize("pixdim", [(-1.0, 2.0, 3.0), (1.0, -2.0, 3.0), (-1.0, -2.0, -3.0)])
def test_the_sign_of_a_nifti_voxel_size_does_not_mirror(
    tmp_path: Path, codes: tuple[int, int], pixdim: tuple[float, ...]
) -> None:
    good = read_organ(nifti_with(tmp_path / "good.nii", {}), (1,), "a")
    fields = {80: struct.pack("<3f", *pixdim), 252: struct.pack("<2h", *codes)}
    bad = read_organ(nifti_with(tmp_path / "bad.nii", fields), (1,), "a")
    index = np.array([[0.0, 0, 0], [3, 4, 5]])
    np.testing.assert_allclose(bad.to_world(index), good.to_world(index), atol=1e-4)  # float32


@pytest.mark.parametrize(("unit", "mm"), [(1, 1000.0), (2, 1.0), (3, 0.001), (0, 1.0)])
@pytest.mark.parametrize("codes", [(0, 1), (1, 0), (1, 1)])
def test_the_unit_of_a_nifti_counts_whichever_form_places_it(
    tmp_path: Path, unit: int, mm: float, codes: tuple[int, int]
) -> None:
    good = read_labels(nifti_with(tmp_path / "good.nii", {}), "a")
    fields = {123: bytes([unit | 8]), 252: struct.pack("<2h", *codes)}  # 8: and times in seconds
    path = nifti_with(tmp_path / "other.nii", fields)
    sizes: tuple[tuple[Unit | None, float], ...] = ((None, mm), ("m", 1000.0))
    for given, factor in sizes:  # what the user says counts first
        other = read_labels(path, "a", given)
        np.testing.assert_allclose(other.spacing_mm, factor * good.spacing_mm, rtol=1e-5)
        np.testing.assert_allclose(other.origin_mm, factor * good.origin_mm, rtol=1e-5)
        np.testing.assert_allclose(other.direction, good.direction, atol=1e-6)


@pytest.mark.parametrize(
    ("scale", "unit"), [(1e-3, "m"), (3e-3, "m"), (0.05, "cm"), (1e3, "um"), (1.0, None)]
)
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_mask_in_another_unit_is_refused_unless_its_unit_is_given(
    tmp_path: Path, suffix: str, scale: float, unit: Unit | None
) -> None:
    spacing = tuple(0.7 * scale * edge for edge in (1.0, 1.2, 2.0))
    path = write(tmp_path / f"a.{suffix}", labels_with_box(), spacing)
    if unit is None:
        assert read_organ(path, (1,), "a").warnings == ()
        return
    with pytest.raises(
        CaseError, match=rf"case a: the liver in a\.\w.* Set data\.unit to {unit}, or mm"
    ):
        read_organ(path, (1,), "a", "liver")
    mask = read_organ(path, (1,), "a", unit=unit)
    np.testing.assert_allclose(mask.spacing_mm, np.multiply(spacing, MM_OF[unit]), rtol=1e-5)


@pytest.mark.parametrize("suffix", ["nrrd", "mha"])
def test_a_unit_that_a_header_states_is_used(tmp_path: Path, suffix: str) -> None:
    path = write(tmp_path / f"a.{suffix}", labels_with_box(), (900.0, 1000.0, 2000.0))
    content = path.read_bytes()
    if suffix == "nrrd":
        old, new = b"kinds:", b'space units: "um" "um" "um"\nkinds:'
    else:
        old, new = b"ElementType", b"DistanceUnits = um\nElementType"
    path.write_bytes(content.replace(old, new, 1))
    mask = read_organ(path, (1,), "a")
    np.testing.assert_allclose(mask.spacing_mm, [0.9, 1, 2])
    assert read_organ(path, (1,), "a", unit="mm").spacing_mm[0] == 900  # what the user says counts


def test_skewed_axes(tmp_path: Path) -> None:
    row = struct.pack("<4f", -1.0, -0.5, 0.0, 0.0)
    path = nifti_with(tmp_path / "a.nii", {252: struct.pack("<2h", 0, 1), 280: row})
    with pytest.raises(CaseError, match=r"not at right angles \(off by [0-9]+ degrees"):
        read_organ(path, (1,), "a")


@pytest.mark.parametrize("offset", [float("nan"), float("inf"), -1e30])
def test_nifti_offset_of_the_voxels(tmp_path: Path, offset: float) -> None:
    path = nifti_with(tmp_path / "a.nii", {108: struct.pack("<f", offset)})
    with pytest.raises(CaseError, match=r"case a: .*puts the voxels at byte"):
        read_organ(path, (1,), "a")


@pytest.mark.parametrize("dim", [(3, -5, 4, 4), (9, 4, 4, 4), (0, 4, 4, 4)])
def test_nifti_dimensions(tmp_path: Path, dim: tuple[int, ...]) -> None:
    path = nifti_with(tmp_path / "a.nii", {40: struct.pack("<4h", *dim)})
    with pytest.raises(CaseError, match=r"case a: .*header gives dimensions"):
        read_organ(path, (1,), "a")


def soft_ball(tmp_path: Path) -> Path:
    """1 in the middle, falling to 0: a ball of radius 8 above 0.5, of radius 4 at 1."""
    z, y, x = np.indices((24, 24, 24)) - 12.0
    values = np.clip(1.5 - np.sqrt(x**2 + y**2 + z**2) / 8, 0, 1).astype(np.float32)
    return write(tmp_path / "soft.nii.gz", values)


def test_a_probability_map_is_asked_for_its_threshold(tmp_path: Path) -> None:
    path = soft_ball(tmp_path)
    with pytest.raises(CaseError, match=r"between whole numbers .*data\.threshold, such as 0\.5"):
        read_organ(path, (1,), "a")
    mask = read_organ(path, (1,), "a", threshold=0.5)
    assert mask.voxels.sum() == pytest.approx(4 / 3 * np.pi * 8**3, rel=0.02)  # a voxelised ball
    with pytest.raises(CaseError, match="largest value is 1"):
        read_organ(path, (1,), "a", threshold=2.0)


@pytest.mark.parametrize("largest", [100, 255])
@pytest.mark.parametrize("kind", [np.uint8, np.int16, np.float32])
def test_a_probability_map_of_whole_numbers_is_asked_for_its_threshold(
    tmp_path: Path, largest: int, kind: type
) -> None:
    z, y, x = np.indices((24, 24, 24)) - 12.0
    values = np.clip(1.5 - np.sqrt(x**2 + y**2 + z**2) / 8, 0, 1)
    path = write(tmp_path / "soft.nii.gz", np.rint(largest * values).astype(kind))
    for label in (1, largest):  # its rim; its certain voxels
        with pytest.raises(CaseError, match=rf" … {largest}\).*threshold, such as {largest // 2}"):
            read_organ(path, (label,), "a")
    mask = read_organ(path, (1,), "a", threshold=largest / 2)
    assert mask.voxels.sum() == pytest.approx(4 / 3 * np.pi * 8**3, rel=0.03)


def test_a_scan_is_no_label_image(tmp_path: Path) -> None:
    scan = np.random.default_rng(0).normal(40, 20, (20, 20, 20)).astype(np.int16)
    with pytest.raises(CaseError, match="as in probability maps and scans"):
        read_organ(write(tmp_path / "ct.nii.gz", scan), (40,), "a")


def test_many_labels_are_labels_however_small(tmp_path: Path) -> None:
    """A hundred organs of 3 × 3 × 3 voxels that touch: one pair in three differs."""
    blocks = np.arange(1, 126).reshape(5, 5, 5)
    labels = np.kron(blocks, np.ones((3, 3, 3))).astype(np.uint8)
    labels[:, :, :6] = 7  # one organ of a size that can be read
    assert read_organ(write(tmp_path / "a.nii.gz", labels), (7,), "a").voxels.sum() == 15 * 15 * 6
    two = np.where(labels % 2, 0, 255).astype(np.uint8)  # a mask as some programs write it
    assert read_organ(write(tmp_path / "b.nii.gz", two), (255,), "b").voxels.any()

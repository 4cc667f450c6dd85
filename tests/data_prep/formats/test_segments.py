"""Segments by name, from files that slicerio and highdicom write."""

import dataclasses
import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK as sitk
from loading import loaded_mask
from scipy.spatial.transform import Rotation
from seg_files import write_dicom_seg, write_seg_nrrd

from ssm_pipeline import storage
from ssm_pipeline.data_prep.cohorts.mask_folder import Organ, find_cases
from ssm_pipeline.data_prep.formats.segments import read_segments
from ssm_pipeline.meshing.settings import MeshingSettings
from ssm_pipeline.records import CaseError, Mask, Mesh, StudyError, SurfaceLabels
from ssm_pipeline.stages.meshing import mesh_case
from ssm_pipeline.study.sources import MaskFolderData

DIRECTION = Rotation.from_euler("zyx", [25, -15, 40], degrees=True).as_matrix()


def two_organs() -> tuple[Mask, dict[str, np.ndarray]]:
    """An oblique, anisotropic grid with two boxes that overlap."""
    liver, spleen = np.zeros((2, 14, 18, 22), bool)
    liver[3:9, 4:14, 3:12] = True
    spleen[6:11, 5:15, 10:19] = True
    mask = Mask(liver, np.array([0.7, 0.9, 2.5]), np.array([-30.0, 12, 200]), DIRECTION, "a")
    return mask, {"liver": liver, "Left spleen": spleen}


def points_of(mask: Mask) -> np.ndarray:
    """Where the voxels lie, sorted: the same whatever order the file has them in."""
    points = mask.to_world(np.argwhere(mask.voxels)[:, ::-1].astype(float))
    return points[np.lexsort(np.round(points, 3).T)]


def write(kind: str, path: Path, mask: Mask, segments: dict[str, np.ndarray]) -> Path:
    if kind == "seg.nrrd":
        return write_seg_nrrd(path / "a.seg.nrrd", mask, segments)
    return write_dicom_seg(path / "a.dcm", mask, segments)


@pytest.mark.parametrize("kind", ["seg.nrrd", "dicom"])
def test_a_segment_lies_where_it_was_written(tmp_path: Path, kind: str) -> None:
    mask, segments = two_organs()
    path = write(kind, tmp_path, mask, segments)
    for name, voxels in segments.items():
        expected = points_of(dataclasses.replace(mask, voxels=voxels))
        found = read_segments(path, (name,), "a")
        np.testing.assert_allclose(points_of(found), expected, atol=1e-4)  # text of 6 to 9 digits
        assert found.warnings == ()
    both = read_segments(path, tuple(segments), "a")
    assert both.voxels.sum() == np.logical_or(*segments.values()).sum()
    # Which part a voxel is of: where both are, the first named.
    assert both.labels is not None
    assert (both.labels == 1).sum() == segments["liver"].sum()
    assert ((both.labels > 0) == both.voxels).all()
    assert read_segments(path, ("LIVER",), "a").voxels.sum() == segments["liver"].sum()


@pytest.mark.parametrize("kind", ["seg.nrrd", "dicom"])
def test_a_name_that_is_not_there(tmp_path: Path, kind: str) -> None:
    path = write(kind, tmp_path, *two_organs())
    with pytest.raises(CaseError, match=r"case a: .*no segment livr; it has Left spleen, liver.*"):
        read_segments(path, ("livr",), "a")


@pytest.mark.parametrize("kind", ["seg.nrrd", "dicom"])
def test_a_name_that_is_there_twice(tmp_path: Path, kind: str) -> None:
    """Which of the two is meant can't be known: neither is taken in silence."""
    mask, segments = two_organs()
    smaller = mask.voxels & (np.indices(mask.voxels.shape)[0] < 8)
    named = {"Liver": segments["liver"], "LIVER": segments["Left spleen"], "liver 2": smaller}
    path = write(kind, tmp_path, mask, named)
    with pytest.raises(CaseError, match=r"case a: .*has 2 segments named liver, and which"):
        read_segments(path, ("liver",), "a")
    own = points_of(dataclasses.replace(mask, voxels=segments["liver"]))
    assert len(points_of(read_segments(path, ("Liver",), "a"))) == len(own)  # exactly so: one
    assert read_segments(path, ("liver 2",), "a").voxels.any()  # other names are as good as ever


def test_one_layer_of_two_labels(tmp_path: Path) -> None:
    """3D Slicer puts segments that don't overlap into one layer, by value."""
    labels = np.zeros((12, 12, 12), np.uint8)
    labels[2:6, 2:10, 2:10], labels[7:11, 2:10, 2:10] = 1, 2
    image = sitk.GetImageFromArray(labels)
    for number, name in ((0, "liver"), (1, "spleen")):
        image.SetMetaData(f"Segment{number}_Name", name)
        image.SetMetaData(f"Segment{number}_LabelValue", str(number + 1))
        image.SetMetaData(f"Segment{number}_Layer", "0")
    path = tmp_path / "a.seg.nrrd"
    sitk.WriteImage(image, str(path))
    np.testing.assert_array_equal(read_segments(path, ("spleen",), "a").voxels, labels == 2)


def test_a_fractional_dicom_seg_is_asked_for_its_threshold(tmp_path: Path) -> None:
    mask, segments = two_organs()
    soft = segments["liver"] * np.linspace(0.2, 1.0, 18)[:, None]
    path = write_dicom_seg(tmp_path / "a.dcm", mask, {"liver": soft}, kind="FRACTIONAL")
    with pytest.raises(CaseError, match=r"data\.threshold"):
        read_segments(path, ("liver",), "a")
    found = read_segments(path, ("liver",), "a", threshold=0.5)
    assert found.voxels.sum() == (soft > 0.5).sum()


def test_two_segments_are_the_parts_of_the_surface(tmp_path: Path) -> None:
    """As two labels are: the study carries their border from case to case as truth."""
    labels = np.zeros((24, 24, 24), np.uint8)
    labels[4:12, 4:20, 4:20], labels[12:20, 4:20, 4:20] = 1, 2
    mask = Mask(labels > 0, np.ones(3), np.zeros(3), np.eye(3), "a")
    write_seg_nrrd(tmp_path / "a.seg.nrrd", mask, {"lower": labels == 1, "upper": labels == 2})
    data = MaskFolderData(folder=tmp_path, segments=("lower", "upper"))
    assert data.has_parts
    assert not MaskFolderData(folder=tmp_path, segments=("lower",)).has_parts
    (case,) = data.find(tmp_path).cases
    mesh_case(case, MeshingSettings(faces=400), tmp_path)
    mesh = storage.load(Mesh, tmp_path / "mesh.npz")
    parts = storage.load(SurfaceLabels, tmp_path / "labels.npz")
    # The border lies at z = 11.5, smoothed over a voxel or two.
    away = np.abs(mesh.vertices[:, 2] - 11.5) > 2
    expected = np.where(mesh.vertices[:, 2] < 11.5, 1, 2)
    np.testing.assert_array_equal(parts.labels[away], expected[away])


def test_one_folder_a_patient(tmp_path: Path) -> None:
    mask, segments = two_organs()
    for patient in ("p1", "p2"):
        (tmp_path / patient / "SEG").mkdir(parents=True)
        write_dicom_seg(tmp_path / patient / "SEG" / "1.2.840.7", mask, segments)  # no suffix
        (tmp_path / patient / "notes.txt").write_text("no DICOM")
        (tmp_path / patient / "DICOMDIR").write_bytes(b"short")
    cohort = find_cases(tmp_path, Organ(segments=("liver",)))
    assert [case.case_id for case in cohort.cases] == ["p1", "p2"]
    assert loaded_mask(cohort.cases[0]).voxels.sum() == segments["liver"].sum()
    write_seg_nrrd(tmp_path / "p1" / "again.seg.nrrd", mask, segments)
    with pytest.raises(StudyError, match="two files share the case id p1"):
        find_cases(tmp_path, Organ(segments=("liver",)))


def test_files_side_by_side_are_named_by_file(tmp_path: Path) -> None:
    mask, segments = two_organs()
    for name in ("b", "a"):
        write_seg_nrrd(tmp_path / f"{name}.seg.nrrd", mask, segments)
    cohort = find_cases(tmp_path, Organ(segments=("Left spleen",)))
    assert [case.case_id for case in cohort.cases] == ["a", "b"]
    assert [case.case_id for case in find_cases(tmp_path).cases] == ["a", "b"]  # by label


@pytest.mark.parametrize("share", [0.7, 0.1])
@pytest.mark.parametrize("kind", ["seg.nrrd", "dicom"])
def test_a_damaged_file_names_its_case(tmp_path: Path, kind: str, share: float) -> None:
    path = write(kind, tmp_path, *two_organs())
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(CaseError, match="case scan_1: "):
        read_segments(path, ("liver",), "scan_1")


def test_a_nrrd_without_names(tmp_path: Path) -> None:
    sitk.WriteImage(sitk.GetImageFromArray(np.ones((9, 9, 9), np.uint8)), tmp_path / "a.nrrd")
    with pytest.raises(CaseError, match=r"case a: a\.nrrd names no segments"):
        read_segments(tmp_path / "a.nrrd", ("liver",), "a")


def test_frames_that_lie_a_kilometre_apart_are_refused(tmp_path: Path) -> None:
    """The slices between them would be filled with nothing: hundreds of gigabytes of it."""
    import pydicom

    path = write_dicom_seg(tmp_path / "a.dcm", *two_organs())
    content = pydicom.dcmread(path)
    for frame in content.PerFrameFunctionalGroupsSequence[:1]:
        position = np.array(frame.PlanePositionSequence[0].ImagePositionPatient, float)
        frame.PlanePositionSequence[0].ImagePositionPatient = list(
            np.round(position - 400_000 * 2.5 * DIRECTION[:, 2], 6)
        )
    content.save_as(path)
    with pytest.raises(CaseError, match=r"case a: .*its frames span 40\d{4} slices"):
        read_segments(path, ("liver",), "a")


@pytest.mark.parametrize(
    ("found", "message"),
    [(b"Segment0_N", "names no segments"), (b"spleen", r"no segment liver; it has \?pleen")],
)
def test_names_that_are_no_text(tmp_path: Path, found: bytes, message: str) -> None:
    image = sitk.GetImageFromArray(np.ones((9, 9, 9), np.uint8))
    image.SetMetaData("Segment0_Name", "spleen")
    path = tmp_path / "a.seg.nrrd"
    sitk.WriteImage(image, str(path))
    damaged = {b"Segment0_N": b"Segment\xff_N", b"spleen": b"\xffpleen"}[found]
    content = path.read_bytes()
    assert found in content
    path.write_bytes(content.replace(found, damaged))
    with pytest.raises(CaseError, match=message) as refused:
        read_segments(path, ("liver",), "a")
    str(refused.value).encode()  # can be shown


def test_a_threshold_is_for_shares_and_not_for_3d_slicers_labels(tmp_path: Path) -> None:
    mask, segments = two_organs()
    path = write_seg_nrrd(tmp_path / "a.seg.nrrd", mask, segments)
    found = read_segments(path, ("Left spleen",), "a", threshold=0.5)
    assert found.voxels.sum() == segments["Left spleen"].sum()


def older_seg_nrrd(
    path: Path, segments: dict[str, np.ndarray], keys: str = "", components: int | None = None
) -> Path:
    """As 3D Slicer before 4.11: a component per segment, no Layer, no LabelValue. `keys` follow."""
    voxels = np.stack(list(segments.values()), axis=-1)[..., :components].astype(np.uint8)
    sizes = [voxels.shape[-1], *voxels.shape[-2::-1]]
    header = [
        "NRRD0004",
        "type: uchar",
        "dimension: 4",
        "space: left-posterior-superior",
        f"sizes: {' '.join(map(str, sizes))}",
        "space directions: none (1,0,0) (0,1,0) (0,0,1)",
        "kinds: list domain domain domain",
        "endian: little",
        "encoding: gzip",
        "space origin: (0,0,0)",
        *(f"Segment{number}_Name:={name}" for number, name in enumerate(segments)),
    ]
    content = "\n".join(header) + "\n" + keys + "\n"
    path.write_bytes(content.encode() + gzip.compress(voxels.tobytes()))
    return path


def twelve_organs() -> dict[str, np.ndarray]:
    """Boxes of different sizes; with twelve, Segment10 comes before Segment2 as text."""
    organs = np.zeros((12, 14, 18, 22), bool)
    for number, organ in enumerate(organs):
        organ[2:8, 3:9, 2 : 8 + number] = True
    return {f"organ {number}": organ for number, organ in enumerate(organs)}


def test_segments_of_an_older_file_are_its_components(tmp_path: Path) -> None:
    organs = twelve_organs()
    path = older_seg_nrrd(tmp_path / "a.seg.nrrd", organs)
    for name, voxels in organs.items():
        np.testing.assert_array_equal(read_segments(path, (name,), "a").voxels, voxels)


@pytest.mark.parametrize(
    ("keys", "components", "message"),
    [
        ("", 11, "names 12 segments without layers and label values, and has 11 layers"),
        ("Segment3_Layer:=3\n", None, "no Segment0_Layer, and other segments have one"),
        ("Segment0_Layer:=0\n", None, "no Segment0_LabelValue"),
    ],
)
def test_segments_without_a_place_are_refused(
    tmp_path: Path, keys: str, components: Any, message: str
) -> None:
    path = older_seg_nrrd(tmp_path / "a.seg.nrrd", twelve_organs(), keys, components)
    with pytest.raises(CaseError, match=message):
        read_segments(path, ("organ 1",), "a")


def test_segments_of_equal_voxels_are_refused(tmp_path: Path) -> None:
    organs = twelve_organs()
    organs["copy"] = organs["organ 4"]
    path = older_seg_nrrd(tmp_path / "a.seg.nrrd", organs)
    with pytest.raises(CaseError, match="segments organ 4 and copy have the same voxels"):
        read_segments(path, ("organ 4",), "a")
    assert read_segments(path, ("organ 5",), "a").voxels.any()
    keys = "".join(f"Segment{i}_Layer:=0\nSegment{i}_LabelValue:=1\n" for i in range(12))
    path = older_seg_nrrd(tmp_path / "b.seg.nrrd", twelve_organs(), keys)
    with pytest.raises(CaseError, match="gives Segment0 and Segment1 the same voxels"):
        read_segments(path, ("organ 4",), "a")

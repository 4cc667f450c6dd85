"""Folders of surfaces: units, spaces, sides, ids."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from shapes import blob

from ssm_pipeline.data_prep.cohorts.selection import Choice
from ssm_pipeline.data_prep.cohorts.surface_folder import find_cases, read_surface
from ssm_pipeline.data_prep.formats.organ_size import Unit
from ssm_pipeline.export.meshes import write_ply
from ssm_pipeline.geometry.surface import volume
from ssm_pipeline.records import CaseError, Mesh, StudyError, Surface

BLOB = blob(0)


def write(path: Path, scale: float = 1.0, mesh: Mesh = BLOB) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.Trimesh(mesh.vertices * scale, mesh.faces, process=False).export(path)
    return path


def test_a_folder_of_every_kind(tmp_path: Path) -> None:
    for name in ("d.stl", "a.obj", "b.ply", "c.off"):
        write(tmp_path / name)
    (tmp_path / "._b.ply").touch()
    (tmp_path / "notes.txt").touch()
    cohort = find_cases(tmp_path)
    assert [case.case_id for case in cohort.cases] == ["a", "b", "c", "d"]
    for case in cohort.cases:
        surface = case.load()
        assert isinstance(surface, Surface)
        found = volume(surface.vertices, surface.faces)
        assert found == pytest.approx(volume(BLOB.vertices, BLOB.faces), rel=1e-5)  # float32


@pytest.mark.parametrize(("unit", "scale"), [("m", 1e-3), ("cm", 1e-1), ("mm", 1.0)])
def test_units(tmp_path: Path, unit: Unit, scale: float) -> None:
    path = write(tmp_path / "a.stl", scale)
    surface = read_surface(path, "a", unit=unit)
    np.testing.assert_allclose(
        np.ptp(surface.vertices, axis=0), np.ptp(BLOB.vertices, axis=0), rtol=1e-5
    )


def test_metres_and_centimetres_are_told_by_size(tmp_path: Path) -> None:
    metres = write(tmp_path / "m.stl", 1e-3)
    with pytest.raises(CaseError, match=r"case m: .*0\.\d+ across.*metres\? Set data\.unit to m"):
        read_surface(metres, "m")
    small = write(tmp_path / "cm.stl", 1e-2)  # a small organ in centimetres
    with pytest.raises(CaseError, match=r"centimetres\? Set data\.unit to cm"):
        read_surface(small, "cm")
    read_surface(small, "cm", unit="mm")  # taken at its word
    with pytest.raises(CaseError, match="micrometres"):
        read_surface(write(tmp_path / "um.stl", 1e3), "um")


def test_ras_is_read_from_the_header_or_said(tmp_path: Path) -> None:
    said = tmp_path / "said.ply"
    write_ply(BLOB.vertices, BLOB.faces, said)  # says SPACE=LPS
    ras = tmp_path / "ras.ply"
    ras.write_bytes(said.read_bytes().replace(b"SPACE=LPS", b"SPACE=RAS"))
    turned = BLOB.vertices * [-1, -1, 1]
    np.testing.assert_allclose(read_surface(said, "a").vertices, BLOB.vertices, atol=1e-4)
    np.testing.assert_allclose(read_surface(ras, "a").vertices, turned, atol=1e-4)
    silent = write(tmp_path / "silent.off")
    np.testing.assert_allclose(read_surface(silent, "a", space="RAS").vertices, turned, atol=1e-4)
    with pytest.raises(CaseError, match=r"says that its coordinates are LPS, .* says RAS"):
        read_surface(said, "a", space="RAS")


def test_the_right_side_mirrored(tmp_path: Path) -> None:
    for patient in ("p1", "p2"):
        for side in ("left", "right"):
            write(tmp_path / patient / f"kidney_{side}.ply")
    cohort = find_cases(tmp_path, pattern="*/kidney_*.ply", choice=Choice(mirror="right"))
    left, right = cohort.cases[:2]
    assert (left.case_id, right.case_id) == ("p1.kidney_left", "p1.kidney_right")
    assert left.patient == right.patient == "p1.kidney"
    one, other = left.load(), right.load()
    assert isinstance(one, Surface)
    assert isinstance(other, Surface)
    np.testing.assert_allclose(other.vertices, one.vertices * [-1, 1, 1], atol=1e-5)
    assert volume(other.vertices, other.faces) == pytest.approx(volume(one.vertices, one.faces))
    write(tmp_path / "p3" / "kidney_horseshoe.ply")
    with pytest.raises(StudyError, match=r"p3\.kidney_horseshoe does not say its side"):
        find_cases(tmp_path, pattern="*/kidney_*.ply", choice=Choice(mirror="right"))


def test_exclusion_is_shown_with_its_reason(tmp_path: Path) -> None:
    for name in "abc":
        write(tmp_path / f"{name}.ply")
    cohort = find_cases(tmp_path, choice=Choice(exclude={"b": "motion"}))
    assert [case.case_id for case in cohort.cases] == ["a", "c"]
    (dropped,) = cohort.dropped
    assert (dropped.case_id, dropped.stage, dropped.reason) == ("b", "data", "excluded: motion")
    with pytest.raises(StudyError, match=r"data\.exclude: there is no case bb .*Did you mean b\?"):
        find_cases(tmp_path, choice=Choice(exclude={"bb": "motion"}))
    with pytest.raises(StudyError, match="needs a reason"):
        find_cases(tmp_path, choice=Choice(exclude={"b": " "}))


def test_ids_that_name_no_folder_drop_their_case(tmp_path: Path) -> None:
    for name in ("a", "quality.csv", "stage.json", "round-1", "x" * 230, "NA"):
        write(tmp_path / f"{name}.ply")
    cohort = find_cases(tmp_path)
    assert [case.case_id for case in cohort.cases] == ["NA", "a"]
    reasons = {case.case_id: case.reason for case in cohort.dropped}
    assert reasons["x" * 230].startswith("the id is 230 bytes long, and 200 are possible")
    assert "the run's own files" in reasons["quality.csv"]
    assert set(reasons) == {"quality.csv", "stage.json", "round-1", "x" * 230}


@pytest.mark.parametrize("pattern", ["/etc/*", "", "  ", "../*.ply", "a/../../*.ply", "a**.ply"])
def test_patterns_that_leave_the_folder(tmp_path: Path, pattern: str) -> None:
    write(tmp_path / "a.ply")
    with pytest.raises(StudyError, match="the pattern"):
        find_cases(tmp_path, pattern=pattern)

"""Surface files are read as another program wrote them, and damage is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import pyvista as pv
import trimesh
from brain_files import write_gifti
from shapes import blob

from ssm_pipeline.data_prep.formats.surface_files import SUFFIXES, is_surface, read_mesh
from ssm_pipeline.export.meshes import write_ply
from ssm_pipeline.geometry.surface import area, volume
from ssm_pipeline.geometry.topology import euler_number
from ssm_pipeline.records import CaseError

MESH = blob(3)


def write(path: Path, binary: bool = True) -> Path:
    """The blob as trimesh or VTK writes it."""
    if path.suffix == ".gii":
        lps = np.array([-1.0, -1.0, 1.0])
        write_gifti(path, MESH.vertices * lps, MESH.faces)
    elif path.suffix in (".vtk", ".vtp", ".vtu") or (
        path.suffix in (".ply", ".stl") and not binary
    ):
        surface = pv.PolyData.from_regular_faces(MESH.vertices, MESH.faces)
        whole = surface.cast_to_unstructured_grid() if path.suffix == ".vtu" else surface
        whole.save(path, binary=binary)
    else:
        trimesh.Trimesh(MESH.vertices, MESH.faces, process=False).export(path)
    return path


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_each_format_gives_the_surface_that_was_written(
    suffix: str, binary: bool, tmp_path: Path
) -> None:
    read = read_mesh(write(tmp_path / f"case{suffix}", binary))
    assert read.case_id == "case"
    assert read.faces.shape == MESH.faces.shape
    assert euler_number(read.faces) == 2  # STL's corners were joined
    # Single precision at 100 mm: 4e-6 mm a coordinate.
    assert area(read.vertices, read.faces) == pytest.approx(area(MESH.vertices, MESH.faces), 1e-5)
    if suffix != ".stl":
        assert np.array_equal(read.faces, MESH.faces)
        assert np.abs(read.vertices - MESH.vertices).max() < 1e-4


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize("suffix", [s for s in SUFFIXES if s != ".obj"])
def test_a_file_that_was_cut_off_is_refused(suffix: str, binary: bool, tmp_path: Path) -> None:
    content = write(tmp_path / f"whole{suffix}", binary).read_bytes()
    cut = tmp_path / f"cut{suffix}"
    # A legacy .vtk ends in what no surface needs, so it is cut within its faces.
    for share in (0.02, 0.4, 0.7) if suffix == ".vtk" else (0.02, 0.4, 0.8, 0.99):
        cut.write_bytes(content[: int(share * len(content))])
        with pytest.raises(CaseError, match=r"case cut: .*(damaged|no faces)"):
            read_mesh(cut)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_file_of_something_else_is_refused(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"letter{suffix}"
    path.write_text("Dear Sir or Madam,\nplease find the liver enclosed.\n")
    with pytest.raises(CaseError, match="letter"):
        read_mesh(path)


def test_points_without_faces_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    trimesh.PointCloud(MESH.vertices).export(path)
    with pytest.raises(CaseError, match="no faces"):
        read_mesh(path)


def test_missing_files_and_other_formats_are_named(tmp_path: Path) -> None:
    with pytest.raises(CaseError, match="there is no file"):
        read_mesh(tmp_path / "liver.stl")
    with pytest.raises(CaseError, match=r"liver\.step is no surface that can be read; \.ply"):
        read_mesh(tmp_path / "liver.step")


def test_faces_that_look_inward_are_turned(tmp_path: Path) -> None:
    path = tmp_path / "inside_out.ply"
    write_ply(MESH.vertices, MESH.faces[:, ::-1], path)
    read = read_mesh(path)
    assert volume(read.vertices, read.faces) == pytest.approx(
        volume(MESH.vertices, MESH.faces), rel=1e-5
    )


def test_squares_are_cut_into_triangles(tmp_path: Path) -> None:
    for suffix in (".vtk", ".ply"):
        path = tmp_path / f"box{suffix}"
        pv.Box().save(path)
        read = read_mesh(path)
        assert read.faces.shape[1] == 3
        assert volume(read.vertices, read.faces) == pytest.approx(8)


def test_slicers_note_of_ras_is_heeded(tmp_path: Path) -> None:
    ras = MESH.vertices * [-1, -1, 1]
    ply = tmp_path / "ras.ply"
    write_ply(ras, MESH.faces, ply)
    ply.write_bytes(ply.read_bytes().replace(b"SPACE=LPS", b"SPACE=RAS", 1))
    vtp = tmp_path / "ras.vtp"
    surface = pv.PolyData.from_regular_faces(ras, MESH.faces)
    surface.field_data["SPACE"] = ["RAS"]
    surface.save(vtp)
    for path in (ply, vtp):
        assert np.abs(read_mesh(path).vertices - MESH.vertices).max() < 1e-4


def test_hidden_files_are_no_surfaces(tmp_path: Path) -> None:
    assert is_surface(write(tmp_path / "a.STL".lower()))
    hidden = tmp_path / "._a.stl"
    hidden.write_bytes(b"")
    assert not is_surface(hidden)
    assert not is_surface(tmp_path)


@pytest.mark.parametrize("jitter_mm", [1e-6, 1e-4])
def test_stl_corners_that_nearly_agree_are_joined(tmp_path: Path, jitter_mm: float) -> None:
    noise = np.random.default_rng(0).normal(0, jitter_mm, (len(MESH.faces), 3, 3))
    corners = (MESH.vertices[MESH.faces] + noise).reshape(-1, 3)
    apart = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
    apart.export(tmp_path / "a.stl")
    read = read_mesh(tmp_path / "a.stl")
    assert euler_number(read.faces) == 2
    assert len(read.vertices) == len(MESH.vertices)
    assert read.faces.shape == MESH.faces.shape


def test_a_grid_of_triangles_is_a_surface_and_one_of_solids_is_not(tmp_path: Path) -> None:
    surface = pv.PolyData.from_regular_faces(MESH.vertices, MESH.faces)
    surface.cast_to_unstructured_grid().save(tmp_path / "a.vtk")
    read = read_mesh(tmp_path / "a.vtk")
    assert euler_number(read.faces) == 2
    assert volume(read.vertices, read.faces) == pytest.approx(
        volume(MESH.vertices, MESH.faces), rel=1e-5
    )
    pv.ImageData(dimensions=(3, 3, 3)).cast_to_unstructured_grid().save(tmp_path / "b.vtu")
    with pytest.raises(CaseError, match="8 of its cells are solids"):
        read_mesh(tmp_path / "b.vtu")


def test_an_stl_text_in_capitals_is_read(tmp_path: Path) -> None:
    text = write(tmp_path / "a.stl", binary=False).read_bytes()
    (tmp_path / "B.STL").write_bytes(text.upper())
    one, other = read_mesh(tmp_path / "a.stl"), read_mesh(tmp_path / "B.STL")
    np.testing.assert_array_equal(one.vertices, other.vertices)
    np.testing.assert_array_equal(one.faces, other.faces)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_names_in_capital_letters_are_read(suffix: str, tmp_path: Path) -> None:
    path = write(tmp_path / f"case{suffix}").rename(tmp_path / f"CASE{suffix.upper()}")
    assert is_surface(path)
    read = read_mesh(path)
    assert (read.case_id, len(read.faces)) == ("CASE", len(MESH.faces))

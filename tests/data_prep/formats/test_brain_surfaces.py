"""GIFTI and FreeSurfer surfaces come in scanner coordinates, LPS."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from brain_files import CENTRE, CONFORMED, TILTED, write_freesurfer, write_gifti
from shapes import blob

from ssm_pipeline.data_prep.cohorts.surface_folder import find_cases
from ssm_pipeline.data_prep.formats.surface_files import is_surface, read_mesh
from ssm_pipeline.records import CaseError

MESH = blob(2)
LPS = np.array([-1.0, -1.0, 1.0])


def scanner_ras(axes: np.ndarray) -> np.ndarray:
    """Where FreeSurfer's matrices put the vertices: vox2ras · inverse of vox2ras-tkr."""
    to_surface = np.array([[-1.0, 0, 0, 128], [0, 0, 1, -128], [0, -1, 0, 128], [0, 0, 0, 1]])
    to_scanner = np.eye(4)
    to_scanner[:3, :3] = axes.T
    to_scanner[:3, 3] = CENTRE - axes.T @ [128, 128, 128]
    both = to_scanner @ np.linalg.inv(to_surface)
    result: np.ndarray = MESH.vertices @ both[:3, :3].T + both[:3, 3]
    return result


@pytest.mark.parametrize("name", ["lh.pial", "lh.white", "rh.white.preaparc", "lung"])
@pytest.mark.parametrize("axes", [CONFORMED, TILTED], ids=["conformed", "tilted"])
def test_freesurfer_surfaces_are_moved_to_the_scanner(
    name: str, axes: np.ndarray, tmp_path: Path
) -> None:
    path = write_freesurfer(tmp_path / name, MESH.vertices, MESH.faces, axes)
    assert is_surface(path)
    read = read_mesh(path)
    assert read.case_id == name
    assert np.array_equal(read.faces, MESH.faces)
    np.testing.assert_allclose(read.vertices, scanner_ras(axes) * LPS, atol=1e-4)
    if axes is CONFORMED:
        np.testing.assert_allclose(read.vertices, (MESH.vertices + CENTRE) * LPS, atol=1e-4)


def test_a_surface_in_scanner_coordinates_stays_there(tmp_path: Path) -> None:
    path = write_freesurfer(tmp_path / "lh.pial", MESH.vertices, MESH.faces)
    head = np.array([2, 0, 20], ">i4").tobytes()
    content = path.read_bytes()
    assert head in content
    path.write_bytes(content.replace(head, np.array([2, 1, 20], ">i4").tobytes()))
    np.testing.assert_allclose(read_mesh(path).vertices, MESH.vertices * LPS, atol=1e-4)


def test_a_surface_without_its_position_and_a_cut_one_are_refused(tmp_path: Path) -> None:
    path = write_freesurfer(tmp_path / "lh.pial", MESH.vertices, MESH.faces, None)
    with pytest.raises(CaseError, match=r"c_ras; write it again with mris_convert --to-scanner"):
        read_mesh(path)
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(CaseError, match=r"promises \d+ vertices and \d+ faces in 500 bytes"):
        read_mesh(path)
    (tmp_path / "lh.curv").write_bytes(b"\xff\xff\xff" + bytes(60))
    assert not is_surface(tmp_path / "lh.curv")


def test_subjects_of_a_freesurfer_folder_are_told_apart(tmp_path: Path) -> None:
    for subject in ("anna", "bert"):
        (tmp_path / subject / "surf").mkdir(parents=True)
        write_freesurfer(tmp_path / subject / "surf" / "lh.pial", MESH.vertices, MESH.faces)
    cohort = find_cases(tmp_path, "*/surf/lh.pial")
    assert [case.case_id for case in cohort.cases] == ["anna", "bert"]


def test_gifti_is_ras_and_moved_where_freesurfer_wrote_it(tmp_path: Path) -> None:
    path = write_gifti(tmp_path / "sub-1_hemi-L_pial.surf.gii", MESH.vertices, MESH.faces)
    read = read_mesh(path)
    assert read.case_id == "sub-1_hemi-L_pial"
    assert np.array_equal(read.faces, MESH.faces)
    np.testing.assert_allclose(read.vertices, MESH.vertices * LPS, atol=1e-4)
    rows = dict(zip("XYZC", [*TILTED, CENTRE], strict=True))
    notes = {
        f"VolGeom{n}_{a}": str(v)
        for n, row in rows.items()
        for a, v in zip("RAS", row, strict=True)
    }
    moved = read_mesh(write_gifti(tmp_path / "lh.gii", MESH.vertices, MESH.faces, notes))
    np.testing.assert_allclose(moved.vertices, scanner_ras(TILTED) * LPS, atol=1e-4)

"""Triangle strips of PLY files become triangles of one orientation."""

from __future__ import annotations

from pathlib import Path

import pytest
from brain_files import write_ply_strips

from ssm_pipeline.data_prep.formats.surface_files import read_mesh
from ssm_pipeline.records import CaseError


@pytest.mark.parametrize("binary", [True, False])
def test_strips_become_triangles(binary: bool, tmp_path: Path) -> None:
    read = read_mesh(write_ply_strips(tmp_path / "a.ply", binary))
    assert read.faces.tolist() == [[0, 1, 2], [2, 1, 3], [2, 3, 4]]
    assert read.vertices[4].tolist() == [0, 2, 1]


def test_strips_that_name_missing_vertices_are_refused(tmp_path: Path) -> None:
    path = write_ply_strips(tmp_path / "a.ply")
    path.write_text(path.read_text().replace("3 4 -1", "3 7 -1"))
    with pytest.raises(CaseError, match="a strip names vertex 7 of 5"):
        read_mesh(path)

"""Landmarks of 3D Slicer, in LPS; a point that is not placed is never left out silently."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from ssm_pipeline.data_prep.formats.landmarks import landmarks_from_markups, read_landmarks
from ssm_pipeline.records import StudyError

FCSV = """# Markups fiducial file version = 4.11
# CoordinateSystem = {system}
# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID
vtkMRMLMarkupsFiducialNode_0,1,2,3,0,0,0,1,1,1,0,apex,,
vtkMRMLMarkupsFiducialNode_1,4,5,6,0,0,0,1,1,1,0,"base, left",,,{status},0
"""


def point(label: str = "apex", status: str = "defined", **more: Any) -> dict[str, Any]:
    return {"label": label, "position": [1.0, 2.0, 3.0], "positionStatus": status} | more


def markups(system: object, *points: dict[str, Any]) -> dict[str, Any]:
    return {"markups": [{"coordinateSystem": system, "controlPoints": points or (point(),)}]}


@pytest.mark.parametrize(
    ("system", "expected"),
    [("LPS", [1, 2, 3]), ("RAS", [-1, -2, 3]), (1, [1, 2, 3]), ("0", [-1, -2, 3])],
)
def test_landmarks_come_out_in_lps(system: object, expected: list[float], tmp_path: Path) -> None:
    read = landmarks_from_markups(markups(system))
    assert read.names == ("apex",)
    assert read.positions.tolist() == [expected]
    path = tmp_path / "a.fcsv"
    path.write_text(FCSV.format(system=system, status=2))
    read = read_landmarks(path)
    assert read.names == ("apex", "base, left")
    assert read.positions[0].tolist() == expected


@pytest.mark.parametrize("status", ["missing", "undefined", "preview"])
def test_a_point_that_is_not_placed_is_refused_by_name(status: str, tmp_path: Path) -> None:
    path = tmp_path / "a.mrk.json"
    path.write_text(json.dumps(markups("LPS", point(), point("base", status), point("tip"))))
    with pytest.raises(StudyError, match=rf"not placed: base \({status}\); place or delete them"):
        read_landmarks(path)
    number = {"undefined": 0, "preview": 1, "missing": 3}[status]
    path.write_text(FCSV.format(system="LPS", status=number))
    with pytest.raises(StudyError, match=rf"not placed: base, left \({status}\)"):
        read_landmarks(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (markups("IJK"), "coordinate system IJK; LPS or RAS"),
        ({"markups": []}, "holds no point"),
        (markups("LPS", point(), point()), "two points apex"),
        (markups("LPS", point(position=[1, 2])), "apex has no finite position"),
        (markups("LPS", {"label": "apex"}), "KeyError: 'position'"),
        ("apex,1,2,3", "neither JSON nor a .fcsv that names its CoordinateSystem"),
    ],
)
def test_what_is_wrong_is_said_with_the_setting(content: Any, message: str, tmp_path: Path) -> None:
    path = tmp_path / "a.file"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    with pytest.raises(StudyError, match=message) as refused:
        read_landmarks(path, "--landmarks")
    assert "or leave --landmarks out" in str(refused.value)

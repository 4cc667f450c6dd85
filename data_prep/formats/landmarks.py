"""Landmarks that 3D Slicer saves: markups as `.mrk.json`, and the older `.fcsv`."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ssm_pipeline.records import StudyError

LANDMARK_SUFFIXES = (".mrk.json", ".fcsv")
_SYSTEMS = {"0": "RAS", "1": "LPS"}  # old Slicer versions wrote the enumeration's number
_STATUSES = {"": "defined", "0": "undefined", "1": "preview", "2": "defined", "3": "missing"}
_COLUMNS = "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID"
_FCSV_STATUS = 14  # the column after those that a .fcsv names


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Named points in patient space.

    Attributes:
        names: `(L,)`, all different.
        positions: `(L, 3)`, mm LPS.
    """

    names: tuple[str, ...]
    positions: np.ndarray

    def __post_init__(self) -> None:
        if self.positions.shape != (len(self.names), 3):
            raise ValueError(
                f"{len(self.names)} landmark names with positions of shape {self.positions.shape}"
            )


@dataclass(frozen=True)
class _Point:
    name: str
    position: tuple[float, ...]
    status: str
    system: str


def read_landmarks(path: Path, setting: str = "report.landmarks") -> Landmarks:
    """Read `.mrk.json` or `.fcsv`, in LPS whatever the file uses.

    Args:
        setting: What names the file, for messages: a setting or an option.

    Raises:
        StudyError: the file can't be read, holds no point, or a point that is not placed.
    """
    advice = f"Save it from 3D Slicer's Markups as .mrk.json or .fcsv, or leave {setting} out."
    try:
        text = path.read_text(encoding="utf-8")
        if text.lstrip().startswith("{"):
            return landmarks_from_markups(json.loads(text))
        return landmarks_from_fcsv(text)
    except OSError as error:
        raise StudyError(
            f"the landmark file {path} can't be read ({error.strerror}). {advice}"
        ) from error
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        what = f"{type(error).__name__}: {error}"
        if isinstance(error, ValueError) and not isinstance(error, json.JSONDecodeError):
            what = str(error)
        raise StudyError(f"the landmark file {path} holds no markups: {what}. {advice}") from error


def landmarks_from_markups(content: Mapping[str, Any]) -> Landmarks:
    """Landmarks of a parsed `.mrk.json` file, in LPS whatever the file uses.

    Raises:
        ValueError: no point, a point that is not placed, two points of one name, or another
            coordinate system than LPS or RAS.
    """
    points: list[_Point] = []
    for markup in content.get("markups", ()):
        system = str(markup.get("coordinateSystem", "LPS"))  # the format's own default
        for point in markup.get("controlPoints", ()):
            name = str(point.get("label") or point.get("id") or len(points) + 1)
            status = str(point.get("positionStatus", "defined"))
            position = point["position"] if status == "defined" else (0, 0, 0)
            points.append(_Point(name, tuple(float(value) for value in position), status, system))
    return _landmarks(points)


def landmarks_from_fcsv(text: str) -> Landmarks:
    """Landmarks of a `.fcsv` file; raises as `landmarks_from_markups` does.

    A file that does not say its coordinate system is refused: versions differ in what they meant.
    """
    header = "\n".join(line for line in text.splitlines() if line.startswith("#"))
    stated = re.search(r"CoordinateSystem\s*=\s*(\S+)", header)
    if stated is None:
        raise ValueError("it is neither JSON nor a .fcsv that names its CoordinateSystem")
    found = re.search(r"columns\s*=\s*(\S+)", header)
    columns = (found[1] if found else _COLUMNS).split(",")
    places = [columns.index(name) for name in ("x", "y", "z", "label", "id")]
    points: list[_Point] = []
    for row in csv.reader(line for line in text.splitlines() if not line.startswith("#")):
        if not row:
            continue
        status = row[_FCSV_STATUS] if len(row) > max(_FCSV_STATUS, len(columns)) else ""
        position = tuple(float(row[place]) for place in places[:3])
        name = row[places[3]] or row[places[4]]
        points.append(_Point(name, position, _STATUSES.get(status, status), stated[1]))
    return _landmarks(points)


def _landmarks(points: list[_Point]) -> Landmarks:
    if not points:
        raise ValueError("it holds no point; place some on the template")
    if pending := [
        f"{point.name} ({point.status})" for point in points if point.status != "defined"
    ]:
        raise ValueError(
            f"it holds points that are not placed: {', '.join(pending)}; place or delete them"
        )
    names = tuple(point.name for point in points)
    if doubled := next((name for name in names if names.count(name) > 1), None):
        raise ValueError(f"it holds two points {doubled}; each needs a name of its own")
    positions = []
    for point in points:
        system = _SYSTEMS.get(point.system, point.system.upper())
        if system not in ("LPS", "RAS"):
            raise ValueError(f"it is in coordinate system {system}; LPS or RAS is needed")
        if len(point.position) != 3 or not np.isfinite(point.position).all():
            raise ValueError(f"the point {point.name} has no finite position x, y, z")
        to_lps = np.array([1.0, 1.0, 1.0] if system == "LPS" else [-1.0, -1.0, 1.0])
        positions.append(np.array(point.position) * to_lps)
    return Landmarks(names, np.stack(positions))

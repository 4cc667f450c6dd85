"""Landmarks placed on the template in 3D Slicer, carried to every case by correspondence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ssm_pipeline.geometry.barycentric import interpolated
from ssm_pipeline.geometry.closest_point import closest_points


@dataclass(frozen=True, eq=False)
class Landmarks:
    """names (L,); positions (L, 3) mm LPS in the template's own space."""

    names: tuple[str, ...]
    positions: np.ndarray

    def __post_init__(self) -> None:
        if self.positions.shape != (len(self.names), 3):
            raise ValueError(
                f"{len(self.names)} landmark names with positions of shape {self.positions.shape}"
            )


def landmarks_from_markups(content: Mapping[str, Any]) -> Landmarks:
    """Landmarks of a parsed Slicer `.mrk.json` file, in LPS whatever the file uses.

    Raises:
        ValueError: If the file holds no point, or names another coordinate system.
    """
    names: list[str] = []
    positions: list[np.ndarray] = []
    for markup in content.get("markups", ()):
        system = str(markup.get("coordinateSystem", "LPS")).upper()
        # Old Slicer versions wrote the enumeration's number: 0 is RAS, 1 is LPS.
        system = {"0": "RAS", "1": "LPS"}.get(system, system)
        if system not in ("LPS", "RAS"):
            raise ValueError(f"landmarks in coordinate system {system}; LPS or RAS is needed")
        to_lps = np.array([1.0, 1.0, 1.0] if system == "LPS" else [-1.0, -1.0, 1.0])
        for point in markup.get("controlPoints", ()):
            if point.get("positionStatus", "defined") != "defined":
                continue  # Slicer keeps a row for a point not placed yet
            names.append(str(point.get("label") or point.get("id") or len(names) + 1))
            positions.append(np.asarray(point["position"], dtype=np.float64) * to_lps)
    if not names:
        raise ValueError("the landmark file holds no placed point; place some on the template")
    return Landmarks(tuple(names), np.stack(positions))


def carry_landmarks(
    positions: np.ndarray, template: np.ndarray, faces: np.ndarray, shapes: np.ndarray
) -> np.ndarray:
    """The same anatomical points on every corresponded shape.

    positions (L, 3) on or near the template; template (V, 3); shapes (N, V, 3); one unit for all.

    Returns:
        (N, L, 3): each landmark keeps its triangle and its place inside it.
    """
    nearest = closest_points(positions, template, faces)
    return interpolated(shapes, faces[nearest.faces], nearest.barycentric)

"""Whether a length could be an organ's in millimetres, and which unit it may be in otherwise."""

from __future__ import annotations

from typing import Literal

import numpy as np

from ssm_pipeline.records import CaseError

Unit = Literal["um", "mm", "cm", "m"]
MM_OF: dict[Unit, float] = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1000.0}
NAMES: dict[Unit, str] = {
    "um": "micrometres",
    "mm": "millimetres",
    "cm": "centimetres",
    "m": "metres",
}
# The diagonal of what could be an organ: a stapes is 4 mm long; a body 2 m.
SMALLEST_MM, LARGEST_MM = 2.0, 3000.0


def likely_unit(diagonal: float) -> Unit | None:
    """The unit that a diagonal is probably in; None if it may be millimetres.

    >>> likely_unit(250.0), likely_unit(0.25), likely_unit(25e3)
    (None, 'm', 'um')
    """
    if SMALLEST_MM <= diagonal <= LARGEST_MM:
        return None
    if diagonal > LARGEST_MM:
        return "um"
    return "m" if diagonal < 0.5 else "cm"


def diagonal_of(points: np.ndarray) -> float:
    """Of the box around points (N, 3) that is parallel to the axes, in the points' unit."""
    return float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0


class UnlikelySize(CaseError):
    """A size that no organ has in millimetres.

    Args:
        case_id: The case.
        found: What was found, in a sentence.
        unit: The unit that the file is probably in.
        setting: Where the user states the unit, up to its value.
    """

    def __init__(
        self, case_id: str, found: str, unit: Unit, setting: str = "Set data.unit to"
    ) -> None:
        super().__init__(
            case_id,
            f"{found} Is it in {NAMES[unit]}? {setting} {unit}, or mm if it is right as it is.",
        )
        self.found, self.unit, self.setting = found, unit, setting

    def __reduce__(self) -> tuple[type, tuple[str, str, Unit, str]]:  # type: ignore[override]
        return type(self), (self.case_id, self.found, self.unit, self.setting)


def check_size(diagonal: float, case_id: str, name: str) -> None:
    """Raise UnlikelySize for a diagonal that no organ has in millimetres; `name` says of what."""
    unit = likely_unit(diagonal)
    if unit is not None:
        found = f"{name} is {diagonal:.3g} across, which is no organ's size in millimetres."
        raise UnlikelySize(case_id, found, unit)

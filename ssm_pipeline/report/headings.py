"""Readable column names: a group, a short heading with its unit, an explanation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ssm_pipeline.statistics.power import EFFECTS_SD

_UNITS = {
    "mm": "mm",
    "ml": "ml",
    "cm2": "cm²",
    "mm2": "mm²",
    "deg": "degrees",
    "percent": "%",
    "mb": "MB",
    "seconds": "s",
    "s": "s",
    "sd": "SD",
}
_WORDS = {
    "case_id": "Case",
    "se": "standard error",
    "hd95": "95th percentile",
    "chamfer": "Chamfer",
    "surface": "surface distance",
    "correspondence": "corresponding points",
    "min": "smallest",
    "dropped": "reason for exclusion",
    "cases_in": "cases in",
    "procrustes_f": "Procrustes F",
    "procrustes_df": "degrees of freedom",
    "procrustes_residual_df": "residual degrees of freedom",
    "hotelling_t2": "Hotelling's T²",
} | {f"power_at_{size}_sd": f"power at {size} SD" for size in EFFECTS_SD}
_STEMS = {
    "to_case": "mean",
    "from_case": "mean",
    "to_case_hd95": "95th percentile",
    "from_case_hd95": "95th percentile",
    "flipped": "flipped triangles",
    "uncovered": "surface not covered",
    "coverage": "coverage tolerance",
    "distinct": "distinct points",
    "round_trip": "round trip",
    "geodesic": "mean geodesic error",
    "geodesic_median": "median geodesic error",
    "geodesic_p95": "95th percentile of the geodesic error",
    "geodesic_x100": "mean geodesic error × 100 / √area",
    "off_surface": "distance off the true surface",
    "lost_piece": "largest part lost",
    "surface_max": "largest",
    "found_4_in_5": "smallest effect with 80 % power",
}
# Neighbouring columns of one of these beginnings share a heading above.
_GROUPS = {
    "generalisation_": "Generalisation",
    "specificity_": "Specificity",
    "to_case_": "Template to case",
    "from_case_": "Case to template",
    "geodesic_": "Geodesic error",
    "floor_": "Floor",
    "surface_": "Surface distance",
}
_EXPLANATIONS = {
    "chamfer": "mean distance to the nearest point of an equally dense sample, both ways, averaged",
    "surface": "mean distance from a vertex to the other surface, both ways, averaged",
    "hd95": "95th percentile of the distance from a vertex to the other surface",
    "correspondence": "mean distance of corresponding points",
    "to_case": "distance from the mapped template to the case's surface",
    "from_case": "distance from the case's surface to the mapped template",
    "flipped": "triangles whose normal is reversed after the template was mapped",
    "uncovered": "surface area of the case without a template point nearby",
    "coverage": "a surface point is covered if a template point is within this distance",
    "distinct": "share of template points that share their vertex of the case with no other",
    "round_trip": "distance between a point and its image after mapping to the case and back",
    "hotelling_t2": "joint test of the leading modes, in standard deviations",
    "hotelling_p": "permutation test of the leading modes together",
    "procrustes_f": "explained over residual mean square, of all coordinates in mm",
    "procrustes_p": "permutation test of all coordinates in mm",
    "explained": "share of the variance that the other terms do not explain",
    "found_4_in_5": "smallest effect that this number of cases detects with 80 % probability",
    "surface_max": "largest distance from the surface of the mask, or of the file, to the mesh",
    "lost_piece": "largest connected part of the mask that the mesh lacks, and how far it reaches",
    "handles_cut": "rings and bridges that were cut open; meshing.cut_handles: false keeps them",
    "variance": "share of the method's own variance that these modes explain",
}


@dataclass(frozen=True)
class Heading:
    """text, short, with its unit; group shared with neighbours, or empty; explanation, on hover."""

    text: str
    group: str = ""
    explanation: str = ""


def heading(column: str) -> str:
    """A column's name as words, its last part being the unit.

    >>> heading("volume_ml")
    'Volume (ml)'
    """
    if column in _WORDS:
        return _capital(_WORDS[column])
    if column in _UNITS:
        return "Time (s)" if _UNITS[column] == "s" else f"({_UNITS[column]})"
    stem, unit = _split(column)
    words = _STEMS.get(stem) or " ".join(_WORDS.get(part, part) for part in stem.split("_"))
    return _capital(f"{words} ({unit})" if unit else words)


def headings(columns: Sequence[str]) -> tuple[Heading, ...]:
    """A table's headings; columns side by side that begin alike are grouped, two or more.

    >>> [h.group for h in headings(["case_id", "to_case_mm", "to_case_hd95_mm"])]
    ['', 'Template to case', 'Template to case']
    """
    starts = [_start(name) for name in columns]
    found = []
    for index, (name, start) in enumerate(zip(columns, starts, strict=True)):
        beside = {*starts[max(index - 1, 0) : index], *starts[index + 1 : index + 2]}
        if start and start in beside:
            own = name if _split(name)[0] in _STEMS else name.removeprefix(start)
            words = heading(own) if own not in _UNITS else f"Mean ({_UNITS[own]})"
            found.append(Heading(words, _GROUPS[start], _explanation(name, start)))
        else:
            found.append(Heading(whole_heading(name), "", _explanation(name, start)))
    return tuple(found)


def whole_heading(column: str) -> str:
    """A heading that stands without a group above it.

    >>> whole_heading("from_case_mm")
    'Case to template, mean (mm)'
    """
    words, start = heading(column), _start(column)
    is_whole = not start or _split(column)[0] not in _STEMS
    return words if is_whole else f"{_GROUPS[start]}, {words[:1].lower()}{words[1:]}"


def _start(column: str) -> str:
    """The group's beginning; only columns with a unit are grouped."""
    has_unit = bool(_split(column)[1])
    return next((start for start in _GROUPS if has_unit and column.startswith(start)), "")


def _explanation(column: str, start: str) -> str:
    stem = _split(column)[0]
    return _EXPLANATIONS.get(stem) or _EXPLANATIONS.get(stem.removeprefix(start), "")


def _split(column: str) -> tuple[str, str]:
    """Stem and unit; the unit is empty where the last part is none."""
    stem, _, last = column.rpartition("_")
    return (stem, _UNITS[last]) if stem and last in _UNITS else (column, "")


def _capital(words: str) -> str:
    """With a capital; a symbol of one letter, p or t, keeps its own."""
    return words if len(words) == 1 else words[:1].upper() + words[1:]

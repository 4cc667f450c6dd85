"""Tables for reading: headings with units, numbers with sensible digits."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

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
}
_WORDS = {
    "case_id": "Case",
    "se": "standard error",
    "hd95": "95th percentile distance",
    "chamfer": "Chamfer distance",
    "surface": "surface distance",
    "correspondence": "corresponding-point distance",
    "min": "smallest",
    "dropped": "left out because",
    "cases_in": "cases in",
}
_STEMS = {
    "to_case": "template to case distance",
    "from_case": "case to template distance",
    "to_case_hd95": "template to case, 95th percentile",
    "from_case_hd95": "case to template, 95th percentile",
    "flipped": "flipped triangles",
    "uncovered": "surface not covered",
    "coverage": "covered means within",
    "distinct": "distinct matched points",
    "round_trip": "round-trip distance",
    "geodesic": "mean geodesic error",
    "geodesic_median": "median geodesic error",
    "geodesic_p95": "95th percentile of the geodesic error",
    "geodesic_x100": "mean geodesic error × 100 / √area",
    "off_surface": "distance off the true surface",
}


@dataclass(frozen=True)
class ReadableTable:
    """headings; rows of text; `is_number` per column, for alignment."""

    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    is_number: tuple[bool, ...]


def heading(column: str) -> str:
    """'volume_ml' → 'Volume (ml)': the unit is the name's last part."""
    if column in _WORDS:
        return _capital(_WORDS[column])
    if column in _UNITS:
        return "Time (s)" if _UNITS[column] == "s" else f"({_UNITS[column]})"
    parts = column.split("_")
    unit = _UNITS.get(parts[-1]) if len(parts) > 1 else None
    stem = "_".join(parts[:-1] if unit else parts)
    words = _STEMS.get(stem) or " ".join(
        _WORDS.get(part, part) for part in (parts[:-1] if unit else parts)
    )
    return _capital(f"{words} ({unit})" if unit else words)


def readable(table: pd.DataFrame) -> ReadableTable:
    """The table as text; a column `x_se_unit` joins its `x_unit` as "value ± standard error"."""
    errors = {name: partner for name in table if (partner := _error_column(str(name))) in table}
    shown = [name for name in table if name not in errors.values()]
    columns = []
    for name in shown:
        decimals = _decimals(table[name])
        column = [text(value, decimals) for value in table[name]]
        if name in errors:
            column = [
                f"{value} ± {text(error, decimals)}" if pd.notna(error) else value
                for value, error in zip(column, table[errors[name]], strict=True)
            ]
        columns.append(column)
    return ReadableTable(
        headings=tuple(heading(str(name)) for name in shown),
        rows=tuple(zip(*columns, strict=True)),
        is_number=tuple(pd.api.types.is_numeric_dtype(table[name]) for name in shown),
    )


def text(value: Any, decimals: int = 2) -> str:
    """A value for reading: numbers with the given decimals, a dash for what is not known."""
    if isinstance(value, list | tuple):
        return "; ".join(map(str, value))
    if value is None or value is pd.NA or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, int | float | np.number):
        written = f"{value:.{decimals}f}"
        return written.replace("-", "" if float(written) == 0 else "−")
    return str(value)


def _error_column(name: str) -> str:
    stem, _, unit = name.rpartition("_")
    return f"{stem}_se_{unit}"


def _decimals(column: pd.Series) -> int:
    """Decimals for a whole column: three digits of its middle value, none for counts."""
    if not pd.api.types.is_numeric_dtype(column) or pd.api.types.is_bool_dtype(column):
        return 2
    known = column.dropna().abs()
    known = known.where(known > 1e-9, 0.0)  # round-off of a zero is a zero
    if (known == known.round()).all():
        return 0
    return int(np.clip(2 - math.floor(math.log10(known[known > 0].median())), 0, 4))


def flattened(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Nested settings as dotted names and text."""
    for name, value in settings.items():
        if isinstance(value, Mapping):
            yield from flattened(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", str(value)


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]

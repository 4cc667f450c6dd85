"""Tables for reading: headings with units, numbers with sensible digits."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

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
    words = " ".join(_WORDS.get(part, part) for part in (parts[:-1] if unit else parts))
    return _capital(f"{words} ({unit})" if unit else words)


def readable(table: pd.DataFrame) -> ReadableTable:
    return ReadableTable(
        headings=tuple(heading(str(column)) for column in table.columns),
        rows=tuple(
            tuple(text(value) for value in row) for row in table.itertuples(index=False, name=None)
        ),
        is_number=tuple(pd.api.types.is_numeric_dtype(kind) for kind in table.dtypes),
    )


def text(value: Any) -> str:
    """A value for reading: three or four digits that matter, a dash for nothing."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    if float(value).is_integer():
        return f"{value:.0f}".replace("-", "−")
    digits = max(0, min(4, 2 - math.floor(math.log10(abs(value)))))
    return f"{value:.{digits}f}".replace("-", "−")


def flattened(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Nested settings as dotted names and text."""
    for name, value in settings.items():
        if isinstance(value, Mapping):
            yield from flattened(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", str(value)


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]

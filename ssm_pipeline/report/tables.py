"""Tables for reading: headings with units, numbers with sensible digits, short case names."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
import pandas as pd

from ssm_pipeline.report.headings import Heading, headings, whole_heading


@dataclass(frozen=True)
class Cell:
    """text as shown; whole: what it stands for, on hover and in the saved CSV, where it differs."""

    text: str
    whole: str = ""


@dataclass(frozen=True)
class ReadableTable:
    """headings; rows of cells; `is_number` per column, for alignment.

    Attributes:
        shared: (heading, value) of columns that say the same in every row; they are told below the
            table and take no room in it.
    """

    headings: tuple[Heading, ...]
    rows: tuple[tuple[Cell, ...], ...]
    is_number: tuple[bool, ...]
    shared: tuple[tuple[str, str], ...] = ()

    @property
    def groups(self) -> tuple[tuple[str, int], ...]:
        """(group, number of columns) along the head's upper row; one of "" a column without."""
        found: list[tuple[str, int]] = []
        for group, members in groupby(self.headings, key=lambda h: h.group):
            count = len(list(members))
            found += [(group, count)] if group else [("", 1)] * count
        return tuple(found)


def readable(
    table: pd.DataFrame,
    names: Mapping[str, str] | None = None,
    keep: tuple[str, ...] = ("case_id", "method", "modes"),
) -> ReadableTable:
    """The table as text; a column `x_se_unit` joins its `x_unit` as "value ± standard error", and
    `x_low_unit` with `x_high_unit` as "value (low to high)".

    Args:
        names: Case id → short name; the whole id stays with the cell.
        keep: Columns that stay even where they say the same in every row.
    """
    names = names or {}
    errors = {name: partner for name in table if (partner := _beside(name, "se")) in table}
    ends = {
        name: pair
        for name in table
        if set(pair := (_beside(name, "low"), _beside(name, "high"))) <= set(table)
    }
    joined = {*errors.values(), *(end for pair in ends.values() for end in pair)}
    shown: list[Any] = []
    shared: list[tuple[str, str]] = []
    for name in table:
        if name in joined:
            continue
        values = {text(value, _decimals(table[name])) for value in table[name]}
        if len(table) > 1 and len(values) == 1 and name not in (*keep, *errors, *ends):
            shared.append((whole_heading(str(name)), values.pop()))
        else:
            shown.append(name)
    shared = [(label, value) for label, value in shared if value not in ("", "–")]
    columns = []
    for name in shown:
        decimals = _decimals(table[name])
        column = [_cell(value, decimals, names) for value in table[name]]
        if name in errors:
            column = [
                Cell(f"{cell.text} ± {text(error, decimals)}", f"{cell.whole} ± {error:.6g}")
                if pd.notna(error)
                else cell
                for cell, error in zip(column, table[errors[name]], strict=True)
            ]
        if name in ends:
            low, high = (table[end] for end in ends[name])
            column = [
                Cell(
                    f"{cell.text} ({text(a, decimals)} to {text(b, decimals)})",
                    f"{cell.whole} ({a:.6g} to {b:.6g})",
                )
                if pd.notna(a) and pd.notna(b)
                else cell
                for cell, a, b in zip(column, low, high, strict=True)
            ]
        columns.append(column)
    return ReadableTable(
        headings=headings([str(name) for name in shown]),
        rows=tuple(zip(*columns, strict=True)),
        is_number=tuple(_is_number(table[name]) for name in shown),
        shared=tuple(shared),
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


def p_text(p: float) -> str:
    """A p-value for reading, no smaller than 0.001.

    >>> p_text(0.0312), p_text(2e-7)
    ('0.031', '< 0.001')
    """
    return "–" if math.isnan(p) else "< 0.001" if p < 0.001 else f"{p:.3f}"


def flattened(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Nested settings as dotted names and text."""
    for name, value in settings.items():
        if isinstance(value, Mapping):
            yield from flattened(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", str(value)


def _cell(value: Any, decimals: int, names: Mapping[str, str]) -> Cell:
    if isinstance(value, str):
        return Cell(names.get(value, value), value)
    shown = text(value, decimals)
    is_fraction = isinstance(value, float | np.floating) and math.isfinite(value)
    return Cell(shown, f"{value:.6g}" if is_fraction else shown)


def _beside(name: Any, what: str) -> str:
    """The column that holds the standard error or an end of the interval of another."""
    stem, _, unit = str(name).rpartition("_")
    return f"{stem}_{what}_{unit}"


def _is_number(column: pd.Series) -> bool:
    return pd.api.types.is_numeric_dtype(column) and not pd.api.types.is_bool_dtype(column)


def _decimals(column: pd.Series) -> int:
    """Decimals for a whole column: three digits of its middle value, none for counts."""
    if not _is_number(column):
        return 2
    if str(column.name).endswith("_z"):
        return 1  # standard scores
    known = column.dropna().abs()
    known = known[np.isfinite(known)]
    known = known.where(known > 1e-9, 0.0)  # round-off of a zero is a zero
    if (known == known.round()).all():
        return 0
    if known.max() < 5e-5:
        return 0  # would all be written 0.0000
    return int(np.clip(2 - math.floor(math.log10(known[known > 0].median())), 0, 4))

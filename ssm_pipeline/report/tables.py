"""Tables for reading: headings with units, numbers with sensible digits, short case names."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
import pandas as pd

from ssm_pipeline.report.headings import Heading, headings, whole_heading


@dataclass(frozen=True)
class Cell:
    """One cell of a table.

    Attributes:
        text: What the page shows.
        whole: The full text, shown on hover where it differs from `text`.
        values: What the saved CSV holds, one entry per column of the CSV: plain numbers or
            text, empty where unknown.
    """

    text: str
    whole: str
    values: tuple[str, ...]


@dataclass(frozen=True)
class ReadableTable:
    """A table as the page shows it.

    Attributes:
        headings: One per column.
        rows: Rows of cells.
        is_number: Per column, for its alignment.
        saved: Per column, the names of its columns in the saved CSV.
        shared: (heading, value) of the columns that have the same value in every row. The page
            shows them below the table.
    """

    headings: tuple[Heading, ...]
    rows: tuple[tuple[Cell, ...], ...]
    is_number: tuple[bool, ...]
    saved: tuple[tuple[str, ...], ...]
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
    """Format a table for the page.

    A column `x_se_unit` is shown in the column `x_unit`, as "value ± standard error". The columns
    `x_low_unit` and `x_high_unit` are shown there as "value (low to high)". The saved CSV holds
    each of these numbers in a column of its own.

    Args:
        table: Any table; column names end in their unit.
        names: Case id → short name. The whole id is shown on hover and saved.
        keep: Columns that stay even if all their rows are equal.
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
    columns, saved = [], []
    for name in shown:
        decimals = _decimals(table[name])
        column = [_cell(value, decimals, names) for value in table[name]]
        own_names = [whole_heading(str(name))]
        if name in errors:
            own_names.append(whole_heading(str(errors[name])))
            column = [
                _beside_cell(cell, " ± {}", (error,), decimals)
                for cell, error in zip(column, table[errors[name]], strict=True)
            ]
        if name in ends:
            own_names += [whole_heading(str(end)) for end in ends[name]]
            column = [
                _beside_cell(cell, " ({} to {})", pair, decimals)
                for cell, *pair in zip(column, *(table[end] for end in ends[name]), strict=True)
            ]
        columns.append(column)
        saved.append(tuple(own_names))
    return ReadableTable(
        headings=headings([str(name) for name in shown]),
        rows=tuple(zip(*columns, strict=True)),
        is_number=tuple(_is_number(table[name]) for name in shown),
        saved=tuple(saved),
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
    """Yield nested settings as dotted names and text; a path without its folders."""
    for name, value in settings.items():
        if isinstance(value, Mapping):
            yield from flattened(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", without_folders(str(value))


# A path of at least two folders, absolute or below the home folder, or of a Windows drive.
_PATH = re.compile(
    r"""(?<![\w./\\:<])(?:~|\.\.)?(?:/[^\s/'",;:]+){2,}/?|[A-Za-z]:[\\/][^\s'",;:]*"""
)


def without_folders(words: str) -> str:
    """Replace each path by its last part: the page may be sent to others.

    >>> without_folders("/home/ann/study 7/masks"), without_folders("cannot read /data/a/b.nii.gz.")
    ('masks', 'cannot read b.nii.gz.')
    """
    if "\n" not in words and re.match(r"~?/|\.\./|[A-Za-z]:[\\/]", words):
        return re.split(r"[\\/]", words.rstrip("\\/"))[-1]
    return _PATH.sub(lambda found: re.split(r"[\\/]", found[0].rstrip("\\/"))[-1], words)


def _cell(value: Any, decimals: int, names: Mapping[str, str]) -> Cell:
    if isinstance(value, str):
        value = without_folders(value)
        return Cell(names.get(value, value), value, (value,))
    shown = text(value, decimals)
    return Cell(shown, shown, (saved_value(value),))


def saved_value(value: Any) -> str:
    """A value as the CSV holds it: six digits, an ordinary minus, empty where unknown.

    >>> saved_value(-0.1234567), saved_value(float("nan")), saved_value(True)
    ('-0.123457', '', 'yes')
    """
    if isinstance(value, int | np.integer) and not isinstance(value, bool):
        return str(value)
    if isinstance(value, float | np.floating):
        return f"{value:.6g}" if math.isfinite(value) else ""
    shown = text(value)
    return "" if shown == "–" else shown


def _beside_cell(cell: Cell, how: str, values: Sequence[Any], decimals: int) -> Cell:
    """The cell with its standard error, or the ends of its interval, if they are known."""
    saved = (*cell.values, *map(saved_value, values))
    if any(map(pd.isna, values)):
        return Cell(cell.text, cell.whole, saved)
    added = cell.text + how.format(*(text(value, decimals) for value in values))
    return Cell(added, added, saved)


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

"""Rows of a delimited text file: its encoding and separator are found from its content."""

from __future__ import annotations

import codecs
import csv
import io
import re
from pathlib import Path

from ssm_pipeline.records import StudyError

SEPARATORS = {",": "comma", ";": "semicolon", "\t": "tab"}
_BYTE_ORDER_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32-le"),  # before UTF-16, whose mark it begins with
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)

Rows = list[tuple[int, list[str]]]  # the number of a row in the file, from 1, and its cells


def rows_of_text(content: bytes, path: Path) -> Rows:
    """Rows of a table in text, without those whose cells are all empty.

    The cells are stripped of blanks, and empty cells at the end of a row are removed.

    Raises:
        StudyError: the encoding is unknown, or no separator or several separators fit.
    """
    text = _decoded(content, path)
    stated = re.match(r"sep=([,;\t])\r?\n", text)  # Excel's first line
    skipped = 1 if stated else 0
    text = text[stated.end() :] if stated else text
    readings: dict[str, Rows] = {}
    faults: dict[int, str] = {}  # width of the header: what is wrong with that reading
    for separator in [stated[1]] if stated else list(SEPARATORS):
        try:
            rows = _split(text, separator, skipped)
        except _NoTable as error:
            faults[error.width] = f"{error}, if cells end at a {SEPARATORS[separator]}"
        else:
            readings[separator] = rows
    tables = {
        separator: rows for separator, rows in readings.items() if rows and len(rows[0][1]) > 1
    }
    if len(tables) > 1:
        fits = " or ".join(
            f"{SEPARATORS[separator]} ({len(rows[0][1])} columns)"
            for separator, rows in tables.items()
        )
        raise StudyError(
            f"the table {path} can be read in several ways, with the separator {fits}. Save it "
            "with one separator, and put cells that contain another one into quotation marks."
        )
    if tables:
        return next(iter(tables.values()))
    if faults and (max(faults) > 1 or not readings):
        raise StudyError(
            f"the table {path} can't be read: {faults[max(faults)]}. Put cells that contain a "
            "separator into quotation marks, or save the table with another separator (comma, "
            "semicolon or tab)."
        )
    return next(iter(readings.values()), [])


class _NoTable(Exception):
    """A separator does not give a table; `width` is the number of columns in the header."""

    def __init__(self, width: int, what: str) -> None:
        super().__init__(what)
        self.width = width


def _decoded(content: bytes, path: Path) -> str:
    for mark, encoding in _BYTE_ORDER_MARKS:
        if content.startswith(mark):
            return _decoded_as(content[len(mark) :], encoding, path)
    if b"\0" in content:
        return _decoded_as(content, _utf_16_without_mark(content, path), path)
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError:
        return _decoded_as(content, "windows-1252", path)


def _utf_16_without_mark(content: bytes, path: Path) -> str:
    """The byte order, by the column names: the high byte of their letters is mostly zero."""
    start = content[:200]
    odd, even = start[1::2].count(0), start[::2].count(0)
    if odd > len(start) // 4 and even == 0:
        return "utf-16-le"
    if even > len(start) // 4 and odd == 0:
        return "utf-16-be"
    raise StudyError(
        f"{path} contains zero bytes and is no text. Save the table as .csv (UTF-8) or .xlsx."
    )


def _decoded_as(content: bytes, encoding: str, path: Path) -> str:
    try:
        return content.decode(encoding)
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise StudyError(
            f"the table {path} is not text in {encoding.upper()} (byte {error.start}, row {line})"
            f"{', nor in UTF-8' if encoding == 'windows-1252' else ''}. Save it again as CSV UTF-8."
        ) from error


def _split(text: str, separator: str, skipped: int) -> Rows:
    """Raises _NoTable."""
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    rows: Rows = []
    width = 0
    row = skipped + 1  # where a row begins: a quoted cell may contain line breaks
    try:
        for read in reader:
            cells = [cell.strip() for cell in read]
            while cells and not cells[-1]:
                cells.pop()
            width = width or len(cells)
            if len(cells) > width:
                raise _NoTable(
                    width,
                    f"row {row} has {len(cells)} cells ({' | '.join(cells)[:80]}) and the header "
                    f"{width}",
                )
            if cells:
                rows.append((row, cells))
            row = skipped + reader.line_num + 1
    except csv.Error as error:
        raise _NoTable(width, f"row {row}: {error}") from error
    if rows and any('"' in cell for cell in rows[0][1]):
        raise _NoTable(1, "a column's name contains a quotation mark")  # that quoted another one
    return rows

"""Tables that users write: .csv, .tsv and .txt in any common encoding, and .xlsx."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from ssm_pipeline.data_prep.formats.spreadsheets import rows_of_workbook
from ssm_pipeline.data_prep.formats.text_tables import rows_of_text
from ssm_pipeline.records import StudyError

EMPTY = ("", "n/a")  # in every column: nothing, and BIDS's word for it
EMPTY_NUMBER = (*EMPTY, "na", "nan", "none", "null", "n.a.", ".", "-", "#n/a")  # any case
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_COMMA_NUMBER = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")
_INTEGER = re.compile(r"[+-]?\d{1,18}")


def read_table(path: Path) -> pd.DataFrame:
    """Read a table; every cell is text without blanks at its ends, and "" if it is empty.

    The content decides how the file is read, not the extension. Encodings: UTF-8, UTF-16, UTF-32,
    and Windows-1252 for text that is none of them. Separators: comma, semicolon or tab, whichever
    gives a table. Rows without any cell are left out.

    Args:
        path: `.csv`, `.tsv`, `.txt` or `.xlsx`. A workbook has cells on one sheet only.

    Returns:
        One column per name in the header. The index `row` is the row's number in the file, from
        1, where the header is usually row 1. Messages to the user should name it.

    Raises:
        StudyError: the file is missing, is no table, or can be read in several ways.

    >>> _ = Path("ages.csv").write_text("case_id;age\\n007;50,5\\n008;61\\n")
    >>> table = read_table(Path("ages.csv"))
    >>> list(table["case_id"]), list(table["age"]), list(table.index)
    (['007', '008'], ['50,5', '61'], [2, 3])
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise StudyError(f"the table {path} can't be read: {error.strerror}.") from error
    if content.startswith(b"\xd0\xcf\x11\xe0"):
        raise StudyError(f"the table {path} is in Excel's old format. Save it as .xlsx or .csv.")
    rows = (rows_of_workbook if content.startswith(b"PK\3\4") else rows_of_text)(content, path)
    if not rows:
        raise StudyError(f"the table {path} is empty. A header and a row per case are needed.")
    header, width = rows[0][1], max(len(cells) for _, cells in rows)
    if width > len(header):
        number, cells = next(row for row in rows if len(row[1]) > len(header))
        raise StudyError(
            f"the table {path}: row {number} has {len(cells)} cells, and the header in row "
            f"{rows[0][0]} names {len(header)}. Name every column, and delete what is not of the "
            "table."
        )
    names = [name or f"column {place}" for place, name in enumerate(header, start=1)]
    if doubled := next((name for name in names if names.count(name) > 1), None):
        raise StudyError(f"the table {path} has two columns {doubled}. Rename or delete one.")
    return pd.DataFrame(
        [cells + [""] * (width - len(cells)) for _, cells in rows[1:]],
        columns=names,
        index=pd.Index([number for number, _ in rows[1:]], name="row"),
        dtype=object,
    )


def typed(table: pd.DataFrame, columns: Sequence[str] | None = None) -> pd.DataFrame:
    """A table with numbers in the columns that hold numbers.

    A column of numbers may have decimal points or decimal commas, and empty cells (nothing, `n/a`,
    `NA`, `NaN`, `None`, `null`, `.`), which become NaN. Every other column stays text, in which
    `NA` and `None` are values like any other, and nothing and `n/a` become NaN.

    Args:
        table: As `read_table` returns it.
        columns: Those to convert; the others stay as they are. None: all.

    Raises:
        StudyError: most cells of a column are numbers and some are not, or its commas may be
            decimal or separate thousands.

    >>> typed(pd.DataFrame({"age": ["50,5", "NA"], "region": ["EU", "NA"]})).values.tolist()
    [[50.5, 'EU'], [nan, 'NA']]
    """
    wanted = list(table.columns) if columns is None else list(columns)
    return table.assign(**{name: typed_column(table[name]) for name in wanted})


def typed_column(cells: pd.Series) -> pd.Series:
    """One column as `typed` converts it. Raises StudyError."""
    filled = cells[[str(cell).lower() not in EMPTY_NUMBER for cell in cells]]
    with_point = [bool(_NUMBER.fullmatch(cell)) for cell in filled]
    with_comma = [bool(_COMMA_NUMBER.fullmatch(cell)) for cell in filled]
    whole = [bool(_INTEGER.fullmatch(cell)) for cell in filled]
    thousands = [bool(_THOUSANDS.fullmatch(cell)) for cell in filled]
    numbers = [any(kinds) for kinds in zip(with_point, with_comma, thousands, strict=True)]
    if not any(numbers) or 2 * sum(numbers) <= len(filled):
        return cells.where([cell.lower() not in EMPTY for cell in cells])
    if not all(numbers):
        _refuse_cells(cells.name, filled[[not number for number in numbers]], "is no number")
    with_comma = [any(kinds) for kinds in zip(with_comma, thousands, strict=True)]
    if any(with_comma):
        if not all(comma or w for comma, w in zip(with_comma, whole, strict=True)):
            fewer = with_comma if 2 * sum(with_comma) <= len(filled) else with_point
            what = "has another decimal sign than the other rows"
            odd = [cell and not w for cell, w in zip(fewer, whole, strict=True)]
            _refuse_cells(cells.name, filled[odd], what)
        commas = filled[with_comma]
        if all(_THOUSANDS.fullmatch(cell) for cell in commas) or max(commas.str.count(",")) > 1:
            _refuse_cells(cells.name, commas, "may be a decimal number or thousands")
    if len(filled) == len(cells) and all(whole):
        return cells.map(int).astype("int64")
    values = filled.str.replace(",", ".").map(float)
    return values.reindex(cells.index).astype("float64")


def _refuse_cells(column: object, cells: pd.Series, what: str) -> None:
    """Raise StudyError naming the first rows of `cells`."""
    named = ", ".join(f"{value!r} in row {row}" for row, value in cells.iloc[:3].items())
    more = f" and {len(cells) - 3} more" if len(cells) > 3 else ""
    raise StudyError(
        f"the column {column} holds numbers, but {named}{more} {what}. Write numbers with a "
        "decimal point in every row and leave unknown cells empty, or, if they are names of "
        "groups, write all of them as words."
    )

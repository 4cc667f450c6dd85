"""Rows of an Excel workbook (.xlsx)."""

from __future__ import annotations

import datetime
import io
import re
import warnings
import zipfile
from pathlib import Path
from typing import Any

from ssm_pipeline.data_prep.formats.text_tables import Rows
from ssm_pipeline.records import StudyError

LARGEST_BYTES = 2**29  # of the unpacked workbook: a table of covariates takes some kilobytes


def rows_of_workbook(content: bytes, path: Path) -> Rows:
    """Rows of the one worksheet that contains cells, as text, without empty rows.

    Formulas are not computed: a cell has the value that the spreadsheet program stored.

    Raises:
        StudyError: the file is damaged or too large, has several tables, or a cell with an error.
    """
    import openpyxl

    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            unpacked = sum(part.file_size for part in archive.infolist())
        if unpacked > LARGEST_BYTES:
            raise StudyError(
                f"the workbook {path} unpacks to {unpacked / 2**20:.0f} MB; {LARGEST_BYTES >> 20} "
                "MB are allowed. Save the table alone, as .csv."
            )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # openpyxl warns of styles and extensions
            workbook = openpyxl.load_workbook(io.BytesIO(content), read_only=True, data_only=True)
            sheets = {sheet.title: _rows_of(sheet, path) for sheet in workbook.worksheets}
    except StudyError:
        raise
    except Exception as error:  # openpyxl raises whatever the damage happens to break
        raise StudyError(
            f"the workbook {path} can't be read ({type(error).__name__}: {error}). Save it again "
            "as .xlsx or .csv."
        ) from error
    filled = {name: rows for name, rows in sheets.items() if rows}
    if len(filled) > 1:
        raise StudyError(
            f"the workbook {path} has {len(filled)} sheets with cells: {', '.join(filled)}. One "
            "table is needed. Save the sheet that is meant as .csv, or delete the others."
        )
    return next(iter(filled.values()), [])


def _rows_of(sheet: Any, path: Path) -> Rows:
    sheet.reset_dimensions()  # some programs write wrong ones
    rows: Rows = []
    for number, row in enumerate(sheet.iter_rows(), start=1):
        cells = [_text_of(cell, number, path) for cell in row]
        while cells and not cells[-1]:
            cells.pop()
        if cells:
            rows.append((number, cells))
    return rows


def _text_of(cell: Any, row: int, path: Path) -> str:
    value = cell.value
    if value is None:
        return ""
    if cell.data_type == "e":
        raise StudyError(
            f"the workbook {path} has the error {value} in row {row}. Correct or empty the cell."
        )
    if isinstance(value, int) and not isinstance(value, bool):
        zeros = re.fullmatch("0+", str(cell.number_format))  # 7 shown as 007
        return str(value).zfill(len(zeros[0])) if zeros else str(value)
    if isinstance(value, datetime.datetime) and value.time() == datetime.time():
        return value.date().isoformat()
    return str(value).strip()

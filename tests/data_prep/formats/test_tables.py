"""Tables of users: one content in every form that spreadsheet programs write."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pandas as pd
import pytest

from ssm_pipeline.data_prep.formats.tables import read_table, typed, typed_column
from ssm_pipeline.records import StudyError

CELLS = [["case_id", "größe"], ["007", "50,5"], ["NA", "61,25"], ["Müller", "70"]]
VALUES = [50.5, 61.25, 70.0]


def in_text(separator: Any, quoted: Any = False) -> Any:
    mark = '"' if quoted else ""
    return "".join(separator.join(f"{mark}{cell}{mark}" for cell in row) + "\r\n" for row in CELLS)


def written(folder: Any, content: Any, name: Any = "a.csv") -> Any:
    (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder / name


def workbook(folder: Any, rows: Any, name: Any = "a.xlsx", **sheets: Any) -> Any:
    book = openpyxl.Workbook()
    for row in rows:
        book.active.append(row)
    for title, content in sheets.items():
        book.create_sheet(title).append(content)
    book.save(folder / name)
    return folder / name


@pytest.mark.parametrize(
    "content",
    [
        in_text(";").encode(),
        in_text("\t").encode(),
        in_text(",", quoted=True).encode(),
        in_text(";", quoted=True).encode(),
        in_text(";").encode("windows-1252"),
        in_text(";").encode("utf-8-sig"),
        in_text("\t").encode("utf-16"),
        in_text("\t").encode("utf-16-le"),
        in_text(";").encode("utf-16-be"),
        in_text(";").encode("utf-32"),
        ("sep=;\r\n" + in_text(";")).encode(),
        in_text(";").replace("\r\n", ";;\r\n").encode() + b";;;\r\n\r\n",
        in_text(";").replace("50,5", " 50,5  ").encode(),
    ],
)
@pytest.mark.parametrize("name", ["a.csv", "a.tsv", "a.txt"])
def test_the_same_table_in_every_form_is_the_same(content: Any, name: str, tmp_path: Path) -> None:
    table = read_table(written(tmp_path, content, name))
    assert list(table.columns) == CELLS[0]
    assert table["case_id"].tolist() == ["007", "NA", "Müller"]
    assert typed(table, ["größe"])["größe"].tolist() == VALUES


def test_a_workbook_is_read_whatever_its_name(tmp_path: Path) -> None:
    rows = [["case_id", "age", "born"], ["007", 50.5, datetime.datetime(1970, 1, 2)], []]
    path = workbook(tmp_path, [*rows, [" NA ", 61, None]], "a.csv")
    table = read_table(path)
    assert table.to_numpy().tolist() == [["007", "50.5", "1970-01-02"], ["NA", "61", ""]]
    assert table.index.tolist() == [2, 4]


def test_zeros_that_a_workbook_shows_are_kept(tmp_path: Path) -> None:
    path = workbook(tmp_path, [["case_id", "age"], [7, 7]])
    book = openpyxl.load_workbook(path)
    book.active["A2"].number_format = "000"
    book.save(path)
    assert read_table(path).to_numpy().tolist() == [["007", "7"]]


def test_what_has_no_single_reading_is_refused_with_the_place(tmp_path: Path) -> None:
    def refused(match: Any, content: Any) -> None:
        with pytest.raises(StudyError, match=match):
            read_table(written(tmp_path, content))

    refused(r"row 3 has 3 cells \(b \| 50 \| 5\) and the header 2", "id,age\na,50\nb,50,5\n")
    refused("semicolon .3 columns", "a,b;c;d\n1,2;3;4\n")
    refused("row 2: unexpected end of data", 'id,age\n"a,5\nb,6\n')
    refused("two columns age", "id,age,age\na,5,6\n")
    refused("zero bytes", b"id,age\n\0\0\0\0" + b"a" * 300)
    refused(r"not text in WINDOWS-1252 \(byte 7, row 2\), nor in UTF-8", b"id,age\n\x81,5\n")
    refused("is empty", b"\n\n")
    refused("old format", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1")
    refused("workbook .* can't be read", b"PK\3\4damaged")
    with pytest.raises(StudyError, match="2 sheets with cells: Sheet, more"):
        read_table(workbook(tmp_path, [["id", "age"], ["a", 5]], more=["x"]))
    with pytest.raises(StudyError, match="error #N/A in row 2"):
        read_table(workbook(tmp_path, [["id", "age"], ["a", "#N/A"]]))
    with pytest.raises(StudyError, match="row 3 has 3 cells, and the header in row 1 names 2"):
        read_table(workbook(tmp_path, [["id", "age"], ["a", 5], ["b", 5, 6]]))
    with pytest.raises(StudyError, match="No such file"):
        read_table(tmp_path / "absent.csv")


def test_a_quoted_separator_in_a_name_is_no_separator(tmp_path: Path) -> None:
    path = written(tmp_path, 'id;"height, m";note\na;1,8;"x; y"\n')
    assert read_table(path).to_dict("list") == {
        "id": ["a"],
        "height, m": ["1,8"],
        "note": ["x; y"],
    }


def column(*cells: Any) -> Any:
    return pd.Series(cells, index=range(2, 2 + len(cells)), name="age", dtype=object)


def test_names_of_groups_stay_and_empty_numbers_are_nan() -> None:
    groups = typed_column(column("None", "NA", "mild", "n/a", ""))
    assert groups[:3].tolist() == ["None", "NA", "mild"]
    assert groups.isna().tolist() == [False, False, False, True, True]
    for empty in ("NA", "NaN", "None", "n/a", "", "."):
        numbers = typed_column(column("1.5", empty, "2"))
        np.testing.assert_array_equal(numbers, [1.5, np.nan, 2])
    assert typed_column(column("1", "2")).dtype == np.int64
    assert typed_column(column("2b", "3c", "4")).tolist() == ["2b", "3c", "4"]


def test_decimal_commas_are_numbers_unless_they_may_be_thousands() -> None:
    assert typed_column(column("1,5", "2,5", "3")).tolist() == [1.5, 2.5, 3.0]
    assert typed_column(column("1,500", "0,250")).tolist() == [1.5, 0.25]
    with pytest.raises(StudyError, match="'1,500' in row 2 may be a decimal number or thousands"):
        typed_column(column("1,500", "200"))
    with pytest.raises(StudyError, match="may be a decimal number or thousands"):
        typed_column(column("1,500,000", "200"))


@pytest.mark.parametrize(
    ("odd", "what"),
    [(">89", "is no number"), ("50,5", "has another decimal sign"), ("5o", "is no number")],
)
def test_a_cell_that_is_no_number_among_numbers_is_refused(odd: str, what: str) -> None:
    with pytest.raises(
        StudyError, match=f"the column age holds numbers, but '{odd}' in row 4 {what}"
    ):
        typed_column(column("50.5", "61.25", odd, "70"))

"""The cohort check on the page: cases that do not look like the others, with a picture each."""

from __future__ import annotations

import base64
from dataclasses import dataclass

from ssm_pipeline.report.content import ReportContent
from ssm_pipeline.report.tables import ReadableTable, readable


@dataclass(frozen=True)
class CheckedCase:
    """A case that does not look like the others: `picture` is a data address or None."""

    case_id: str
    name: str
    picture: str | None
    remark: str


@dataclass(frozen=True)
class CohortCheck:
    """The cohort check for the page.

    Attributes:
        shown: The cases with a remark, each with its picture.
        table: All cases; those with a remark first.
        count: How many cases were checked.
    """

    shown: tuple[CheckedCase, ...]
    table: ReadableTable
    count: int


def check_cases(content: ReportContent) -> CohortCheck | None:
    """Format the table `cohort_check`; None if the run has none.

    The remarks of the check decide which cases are shown. The thresholds are defined there.
    """
    table = content.check
    if table is None or table.empty:
        return None
    names = content.names
    scores = [str(name) for name in table if str(name).endswith("_z")]
    said = table["remarks"].fillna("").astype(str)
    remarks = dict(zip(table["case_id"].astype(str), said, strict=True))
    order = table["case_id"].astype(str).map(lambda case_id: remarks[case_id] == "")
    table = table.loc[order.sort_values(kind="stable").index]
    return CohortCheck(
        shown=tuple(
            CheckedCase(
                case_id,
                names.get(case_id, case_id),
                _address(content.check_pictures.get(case_id)),
                remarks[case_id],
            )
            for case_id in table["case_id"].astype(str)
            if remarks[case_id]
        ),
        table=readable(table, names, keep=("case_id", *scores)),
        count=len(table),
    )


def _address(png: bytes | None) -> str | None:
    return None if png is None else "data:image/png;base64," + base64.b64encode(png).decode()

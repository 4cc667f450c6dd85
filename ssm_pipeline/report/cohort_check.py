"""The cohort check on the page: cases that do not look like the others, with a picture each."""

from __future__ import annotations

import base64
from dataclasses import dataclass

from ssm_pipeline.report.content import ReportContent
from ssm_pipeline.report.tables import ReadableTable, readable


@dataclass(frozen=True)
class CheckedCase:
    """name as shown; picture: a data address or None; remark: what is striking, or empty."""

    case_id: str
    name: str
    picture: str | None
    remark: str


@dataclass(frozen=True)
class CohortCheck:
    """cases, those with a remark first; the whole table; how many have a remark."""

    cases: tuple[CheckedCase, ...]
    table: ReadableTable
    striking: int


def check_cases(content: ReportContent) -> CohortCheck | None:
    """The table `cohort_check` for reading; None where the run has none.

    A case is striking where the check wrote a remark: its thresholds stand there, once.
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
        cases=tuple(
            CheckedCase(
                case_id,
                names.get(case_id, case_id),
                _address(content.check_pictures.get(case_id)),
                remarks[case_id],
            )
            for case_id in table["case_id"].astype(str)
        ),
        table=readable(table, names, keep=("case_id", *scores)),
        striking=sum(remark != "" for remark in remarks.values()),
    )


def _address(png: bytes | None) -> str | None:
    return None if png is None else "data:image/png;base64," + base64.b64encode(png).decode()

"""The cohort check on the page: cases that do not look like the others, with a picture each."""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass

import pandas as pd

from ssm_pipeline.report.content import ReportContent
from ssm_pipeline.report.headings import heading
from ssm_pipeline.report.tables import ReadableTable, readable, text

STRIKING = 3.5  # robust standard deviations from the median: Iglewicz and Hoaglin 1993
_REMARKS = ("remarks", "flags", "remark", "reasons", "looks")


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

    A case is striking where the check wrote a remark, or one of its columns `…_z` is STRIKING or
    more away from 0.
    """
    table = content.check
    if table is None or table.empty:
        return None
    names = content.names
    words = next((name for name in _REMARKS if name in table), None)
    scores = [str(name) for name in table if str(name).endswith("_z")]
    remarks = {}
    for _, row in table.iterrows():
        said = "" if words is None or pd.isna(row[words]) else text(row[words])
        far = [
            f"{heading(name.removesuffix('_z')).lower()} {text(float(row[name]), 1)}"
            for name in scores
            if math.isfinite(row[name]) and abs(row[name]) >= STRIKING
        ]
        remarks[str(row["case_id"])] = said or (f"z: {', '.join(far)}" if far else "")
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

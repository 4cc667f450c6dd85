"""The cohort check's section: who is striking, in which order, with which picture."""

from __future__ import annotations

import dataclasses
from typing import Any

import pandas as pd
import pytest

from ssm_pipeline.report.cohort_check import check_cases


def checked(content: Any, **columns: Any) -> Any:
    ids = list(content.aligned.case_ids)
    table = pd.DataFrame({"case_id": ids, **columns})
    return check_cases(dataclasses.replace(content, check=table, check_pictures={ids[2]: b"png"}))


def test_striking_cases_come_first_with_their_reason(content: Any) -> None:
    remarks = [""] * 8
    remarks[2], remarks[5] = "mirrored", "size"
    found = checked(content, volume_z=[0.0] * 8, remarks=remarks)
    # The others have no card: there is nothing to say of them.
    assert [case.case_id for case in found.shown] == ["blob.002", "blob.005"]
    assert [case.remark for case in found.shown] == ["mirrored", "size"]
    assert found.shown[0].picture == "data:image/png;base64,cG5n"
    assert found.shown[1].picture is None
    assert [row[0].text for row in found.table.rows[:3]] == ["blob.002", "blob.005", "blob.000"]


def test_without_a_check_there_is_no_section(content: Any) -> None:
    assert check_cases(content) is None
    with pytest.raises(ValueError, match="cohort_check lacks column"):
        dataclasses.replace(content, check=pd.DataFrame({"volume_z": [1.0]}))


def test_unknown_scores_and_no_remarks(content: Any) -> None:
    found = checked(content, volume_z=[float("nan")] * 8, remarks=[None] * 8)
    assert found.shown == ()
    assert found.count == 8

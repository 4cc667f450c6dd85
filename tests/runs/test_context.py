"""What stages are told about patients."""

from __future__ import annotations

import types
from pathlib import Path
from typing import Any, cast

import pytest

from ssm_pipeline.cohort_check.copies import copies_table
from ssm_pipeline.records import CaseSource, Cohort, Mask
from ssm_pipeline.runs.context import patients_of


def no_mask() -> Mask:
    raise AssertionError("nothing is read")


@pytest.mark.parametrize("twins", [[], [("a", "c", "the same"), ("b", "d", "the mirror image")]])
def test_copies_are_held_out_together(tmp_path: Path, twins: list[tuple[str, str, str]]) -> None:
    patients = {"a": "01", "b": "01", "c": "1", "d": ""}
    cases = tuple(CaseSource(name, (), no_mask, who) for name, who in patients.items())
    (tmp_path / "cohort_check").mkdir()
    (tmp_path / "cohort_check" / "stage.json").write_text("{}")
    copies_table(twins).to_csv(tmp_path / "cohort_check" / "copies.csv", index=False)
    context = types.SimpleNamespace(
        cohort=Cohort("x", cases), run_folder=tmp_path, readable=frozenset({"cohort_check"})
    )
    found = patients_of(cast(Any, context), ["d", "c", "a", "b"])
    own = "01" if twins else "1"
    assert found == {"d": "d", "c": own, "a": "01", "b": "01"}

"""Copies of one case: a table with the lines to exclude them, and one patient for all copies."""

from __future__ import annotations

import pandas as pd

from ssm_pipeline.cohort_check.copies import (
    advice_on_copies,
    copies_table,
    copy_pairs,
    held_together,
)

TWINS = [("c", "a", "the same"), ("c", "x", "the same"), ("d", "e", "the mirror image")]


def test_each_copy_is_named_once_with_its_line() -> None:
    table = copies_table(TWINS)
    assert table["case_id"].tolist() == ["a", "x"]
    assert table["copy_of"].tolist() == ["c", "c"]
    assert table["exclude"].tolist() == ['"a": "copy of c"', '"x": "copy of c"']
    assert advice_on_copies(table)[-3:] == ["  exclude:", *(f"    {e}" for e in table["exclude"])]
    assert advice_on_copies(copies_table(TWINS[2:])) == []


def test_copies_unite_their_patients() -> None:
    patients = {"a": "A", "a2": "A", "c": "C", "x": "X", "d": "D", "e": "E"}
    united = held_together(patients, copy_pairs(copies_table(TWINS)))
    # a and c are one case, so patient A's other case is held out with them, too.
    assert united == {"a": "A", "a2": "A", "c": "A", "x": "A", "d": "D", "e": "E"}
    assert held_together(patients, [("a", "unknown")]) == patients
    assert held_together(patients, copy_pairs(pd.DataFrame(columns=["case_id", "copy_of"]))) == (
        patients
    )

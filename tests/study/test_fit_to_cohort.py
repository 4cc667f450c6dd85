"""What the cases don't allow is said before any work."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import pytest
import yaml

from ssm_pipeline.records import CaseSource, Cohort, Mask, StudyError
from ssm_pipeline.study.fit_to_cohort import refuse_copies, refuse_what_cannot_fit
from ssm_pipeline.study.settings import StudySettings


def no_mask() -> Mask:
    raise AssertionError("nothing is read")


COHORT = Cohort("five", tuple(CaseSource(f"00{n}", (Path("a"),), no_mask) for n in range(5)))


def settings_with(**over: object) -> StudySettings:
    return StudySettings.model_validate({"data": {"source": "masks", "folder": "m"}, **over})


def test_a_template_that_is_no_case_is_refused_and_the_nearest_named() -> None:
    with pytest.raises(StudyError, match=r"template 04 is not among the 5 cases.*Did you mean"):
        refuse_what_cannot_fit(settings_with(template="04"), COHORT)
    refuse_what_cannot_fit(settings_with(template="004"), COHORT)


@pytest.mark.parametrize("folds", [1, 2, 6])
def test_folds_that_leave_no_model_are_refused(folds: int) -> None:
    """Two folds of five cases leave two; three folds leave three."""
    with pytest.raises(
        StudyError, match=rf"evaluation\.folds is {folds}, but the study has 5 cases"
    ):
        refuse_what_cannot_fit(settings_with(evaluation={"folds": folds}), COHORT)


@pytest.mark.parametrize("folds", [0, 3, 5])
def test_folds_that_leave_a_model_are_fine(folds: int) -> None:
    refuse_what_cannot_fit(settings_with(evaluation={"folds": folds}), COHORT)


def cohort_of_files(folder: Path, contents: Mapping[str, str]) -> Cohort:
    for name, content in contents.items():
        (folder / name).write_text(content)
    return Cohort("x", tuple(CaseSource(name, (folder / name,), no_mask) for name in contents))


def test_copies_of_one_file_are_refused_with_the_lines_that_exclude_them(tmp_path: Path) -> None:
    copied = cohort_of_files(tmp_path, {"a": "1", "b": "2", "c": "3", "007": "2", "e": "22"})
    with pytest.raises(StudyError, match="of 5 cases, 1 is a copy") as refused:
        refuse_copies(copied)
    assert str(refused.value).endswith('data:\n  exclude:\n    "007": "copy of b"')
    lines = str(refused.value)[str(refused.value).index("data:") :]
    assert yaml.safe_load(lines) == {"data": {"exclude": {"007": "copy of b"}}}
    # Two organs of one image share a file and are no copies.
    one = copied.cases[0]
    refuse_copies(Cohort("x", (one, dataclasses.replace(one, case_id="a.right"))))

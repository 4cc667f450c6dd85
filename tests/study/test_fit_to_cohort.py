"""What the cases don't allow is said before any work."""

from __future__ import annotations

from pathlib import Path

import pytest

from ssm_pipeline.records import CaseSource, Cohort, Mask, StudyError
from ssm_pipeline.study.fit_to_cohort import refuse_what_cannot_fit
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
    with pytest.raises(StudyError, match=rf"evaluation\.folds is {folds}, of 5 cases"):
        refuse_what_cannot_fit(settings_with(evaluation={"folds": folds}), COHORT)


@pytest.mark.parametrize("folds", [0, 3, 5])
def test_folds_that_leave_a_model_are_fine(folds: int) -> None:
    refuse_what_cannot_fit(settings_with(evaluation={"folds": folds}), COHORT)

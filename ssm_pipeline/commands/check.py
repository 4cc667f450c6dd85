"""`workflow check`: read every mask of a study and say what is wrong with it."""

from __future__ import annotations

from pathlib import Path

from ssm_pipeline.engine.runner import FEWEST_CASES
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.records import CaseError
from ssm_pipeline.study.fit_to_cohort import refuse_what_cannot_fit
from ssm_pipeline.study.study import Study


def check_study(study: Study, terminal: Terminal) -> bool:
    """True if every mask can be read and enough of them can be used. Writes nothing.

    Raises StudyError for settings that don't fit the cases.
    """
    terminal.say(f"settings   {study.path}: in order")
    if study.settings.data.source == "phantoms":
        terminal.say("masks      none given: synthetic phantoms will be made")
        return True
    cohort = study.settings.data.find(Path())
    refuse_what_cannot_fit(study.settings, cohort)
    usable = 0
    with terminal.steps("masks", len(cohort.cases)) as steps:
        for number, case in enumerate(cohort.cases, start=1):
            try:
                mask = case.load()
            except CaseError as error:
                terminal.say(f"      {error}")
            else:
                usable += 1
                for warning in mask.warnings:
                    terminal.say(f"      case {case.case_id}: {warning}")
            steps.advance_to(number)
    terminal.say(f"masks      {usable} of {len(cohort.cases)} can be read")
    if usable < FEWEST_CASES:
        terminal.say(f"           at least {FEWEST_CASES} are needed")
    return usable == len(cohort.cases) and usable >= FEWEST_CASES

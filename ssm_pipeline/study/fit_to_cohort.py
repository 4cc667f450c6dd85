"""Checks of a study's settings against its cases, before any work."""

from __future__ import annotations

import math

from ssm_pipeline.cohort_check.copies import exclude_line
from ssm_pipeline.counting import counted
from ssm_pipeline.engine.keys import key_of_files
from ssm_pipeline.records import CaseSource, Cohort, StudyError
from ssm_pipeline.study.settings import StudySettings
from ssm_pipeline.study.yaml_settings import nearest

FEWEST_KEPT = 3  # cases that a model is built from when others are held out


def refuse_what_cannot_fit(settings: StudySettings, cohort: Cohort) -> None:
    """Raise StudyError for settings that these cases don't allow.

    These are: copies of one file that are not excluded, a template that is no case, impossible
    folds, and weights to start from that are of other networks.
    """
    refuse_copies(cohort)
    if settings.matching == "network" and settings.training.start != "none":
        from ssm_pipeline.training.start import refuse_other_networks  # it imports PyTorch

        refuse_other_networks(settings.training)
    case_ids = [case.case_id for case in cohort.cases]
    if settings.template is not None and settings.template not in case_ids:
        raise StudyError(
            f"the template {settings.template} is not among the {len(case_ids)} cases."
            f"{nearest(settings.template, case_ids[:20])} Name a case, or leave template out."
        )
    folds, count = settings.evaluation.folds, len(case_ids)
    if folds and (folds > count or folds == 1 or count - math.ceil(count / folds) < FEWEST_KEPT):
        raise StudyError(
            f"evaluation.folds is {folds}, but the study has {counted(count, 'case')}. From 2 to "
            f"{count} folds are possible, and each must leave {FEWEST_KEPT} cases. Set another "
            "number, or 0 to leave out one case at a time."
        )


def refuse_copies(cohort: Cohort) -> None:
    """Raise StudyError for cases whose files have the same content, unless all have.

    Cases that share one file, as the two lungs of a scan, are different organs.
    """
    if cohort.is_synthetic:
        return
    of_size: dict[tuple[int, ...], list[CaseSource]] = {}
    there = (case for case in cohort.cases if all(path.is_file() for path in case.files))
    for case in there:
        sizes = tuple(path.stat().st_size for path in case.files)
        of_size.setdefault(sizes, []).append(case)
    first: dict[str, CaseSource] = {}
    copies: dict[str, str] = {}
    for cases in of_size.values():
        if len({case.files for case in cases}) == 1:
            continue
        for case in cases:
            original = first.setdefault(key_of_files(case.files), case)
            if case.files != original.files:
                copies[case.case_id] = original.case_id
    if copies and len(copies) < len(cohort.cases) - 1:  # the engine refuses copies of one file
        lines = "".join(f"\n    {exclude_line(*pair)}" for pair in sorted(copies.items()))
        raise StudyError(
            f"of {len(cohort.cases)} cases, {counted(len(copies), 'is a copy', 'are copies')} of "
            "another case's file, and a model would count such cases twice. Add to the study:\n"
            f"data:\n  exclude:{lines}"
        )

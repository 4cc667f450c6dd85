"""Do a study's settings fit its cases? Asked before the hours of work, not after."""

from __future__ import annotations

import math

from ssm_pipeline.records import Cohort, StudyError
from ssm_pipeline.study.settings import StudySettings
from ssm_pipeline.study.yaml_settings import nearest

FEWEST_KEPT = 3  # cases that a model is built from when others are held out


def refuse_what_cannot_fit(settings: StudySettings, cohort: Cohort) -> None:
    """Raise StudyError for a template or folds that these cases don't allow, or weights to start
    from that are no such weights."""
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
            f"evaluation.folds is {folds}, of {count} cases; from 2 to {count} folds are possible, "
            f"and each must leave {FEWEST_KEPT} cases. Ask for other folds, or 0: one case a time."
        )

"""Stage `data`: which cases there are, and the files they rest on."""

from __future__ import annotations

from ssm_pipeline.engine.stage import Outcome
from ssm_pipeline.records import Cohort
from ssm_pipeline.runs.context import Context


def list_cases(context: Context) -> Outcome:
    """cohort.csv: the cases, whom they are of, and the files they rest on."""
    rows = [
        {
            "case_id": case.case_id,
            "patient": case.patient or case.case_id,
            "files": "; ".join(path.name for path in case.files),
        }
        for case in context.cohort.cases
    ]
    context.write_table("cohort", rows)
    rests_on = context.settings.data.case_settings()
    keys = {case_id: context.case_key(case_id, case_id, rests_on) for case_id in context.case_keys}
    return Outcome(keys, context.cohort.dropped, note=_how_affine(context.cohort))


def _how_affine(cohort: Cohort) -> str:
    """Of phantoms: a cohort that is nearly affine proves little."""
    if cohort.truth is None:
        return ""
    from ssm_pipeline.geometry.affine import affine_share

    return f"{100 * affine_share(cohort.truth.vertices):.0f} % of the variance is affine"

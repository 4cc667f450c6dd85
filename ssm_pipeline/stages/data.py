"""Stage `data`: the cases, their patients and their files."""

from __future__ import annotations

from typing import Any

from ssm_pipeline.data_prep.cohorts.patients import advice_on_patients
from ssm_pipeline.engine.keys import key_of_files
from ssm_pipeline.engine.stage import Outcome
from ssm_pipeline.records import Cohort, StudyError
from ssm_pipeline.runs.context import Context
from ssm_pipeline.study.settings import StudySettings

TABLE_COLUMNS = ("visit", "side", "site")  # of a patient table, beside the patient


def list_cases(context: Context) -> Outcome:
    """cohort.csv: the cases, their patients, what the patient table says of them, their files."""
    cases = context.cohort.cases
    stated = [name for name in TABLE_COLUMNS if any(getattr(case, name) for case in cases)]
    rows = [
        {
            "case_id": case.case_id,
            "patient": case.patient or case.case_id,
            **{name: getattr(case, name) for name in stated},
            "files": "; ".join(path.name for path in case.files),
        }
        for case in cases
    ]
    context.write_table("cohort", rows)
    advice = advice_on_patients({str(row["case_id"]): str(row["patient"]) for row in rows})
    if advice and context.cohort.truth is None:
        context.terminal.detail(f"{advice}")
    rests_on = context.settings.data.case_settings()
    keys = {case_id: context.case_key(case_id, case_id, rests_on) for case_id in context.case_keys}
    return Outcome(keys, context.cohort.dropped, note=_how_affine(context.cohort))


def data_dependencies(settings: StudySettings) -> dict[str, Any]:
    """The settings of the data and the content of the patient table. Raises StudyError."""
    found: dict[str, Any] = {"data": settings.data.model_dump(mode="json", exclude={"folder"})}
    patients = getattr(settings.data, "patients", None)
    if patients is not None:
        if not patients.is_file():
            raise StudyError(f"data.patients: there is no file {patients}. Give a table's path.")
        found["patients"] = key_of_files([patients])
    return found


def _how_affine(cohort: Cohort) -> str:
    """Of phantoms: a cohort that is nearly affine proves little."""
    if cohort.truth is None:
        return ""
    from ssm_pipeline.geometry.affine import affine_share

    return f"{100 * affine_share(cohort.truth.vertices):.0f} % of the variance is affine"

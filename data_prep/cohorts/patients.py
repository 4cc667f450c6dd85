"""The patient of each case: from a table of the user, and ids that look like one patient's."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ssm_pipeline.data_prep.cohorts.sides import side_in_name
from ssm_pipeline.data_prep.formats.tables import read_table
from ssm_pipeline.records import CaseSource, StudyError

CASE_COLUMNS = ("case", "case_id", "participant_id")
_VISIT = re.compile(
    r"(?:^|[._ -])((?:ses|visit|v|tp|t|scan|time|week|month|year|m)[-_]?\d+"
    r"|baseline|bl|follow[-_]?up|fu\d*|pre|post|preop|postop)(?=$|[._ -])",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class PatientRow:
    """One row of a patient table: the patient of a case, and what else the table says."""

    patient: str
    visit: str = ""
    side: str = ""
    site: str = ""


def read_patients(path: Path) -> dict[str, PatientRow]:
    """Read a table with a row per case.

    Args:
        path: A table with the columns `case` (or `case_id`) and `patient`. The columns `visit`,
            `side` and `site` are optional. Ids are text: "01" stays "01".

    Returns:
        Case id → its row.

    Raises:
        StudyError: A column is missing, a cell is empty, or a case has two rows.
    """
    table = read_table(path)
    case_column = next((name for name in CASE_COLUMNS if name in table), None)
    if case_column is None or "patient" not in table:
        raise StudyError(
            f"data.patients: {path} has the columns {', '.join(table.columns)}. The columns case "
            "and patient are needed; visit, side and site are optional."
        )
    rows: dict[str, PatientRow] = {}
    for number, cells in table.iterrows():
        case_id, patient = cells[case_column], cells["patient"]
        if not case_id or not patient:
            raise StudyError(
                f"data.patients: row {number} of {path} has no {'patient' if case_id else 'case'}. "
                "Fill in the cell, or delete the row."
            )
        if case_id in rows:
            raise StudyError(
                f"data.patients: {path} has two rows of the case {case_id}. Delete one of them."
            )
        rows[case_id] = PatientRow(
            patient, **{name: cells.get(name, "") for name in ("visit", "side", "site")}
        )
    return rows


def with_patients(
    sources: Sequence[CaseSource], rows: Mapping[str, PatientRow]
) -> list[CaseSource]:
    """The cases with the patients of a table; no table (no rows) changes nothing.

    Rows of other cases are allowed: the table may be of the whole data set.

    Raises:
        StudyError: A case has no row, or its side contradicts the side in its id.
    """
    if not rows:
        return list(sources)
    missing = [source.case_id for source in sources if source.case_id not in rows]
    if missing:
        raise StudyError(
            f"data.patients: the table has no row of {len(missing)} of the {len(sources)} cases: "
            f"{', '.join(missing[:5])}{' …' if len(missing) > 5 else ''}. Its first cases are "
            f"{', '.join(list(rows)[:3])}. Add a row per case, with the id as the run shows it."
        )
    for source in sources:
        named, stated = side_in_name(source.case_id)[0], rows[source.case_id].side
        if named and stated and (side_in_name(stated)[0] or named) != named:
            raise StudyError(
                f"data.patients: the id {source.case_id} says {named} and the table says {stated}. "
                "Correct the table, or rename the file."
            )
    return [replace(source, **vars(rows[source.case_id])) for source in sources]


def patient_in_name(case_id: str) -> str:
    """An id without the words that name a side or a visit.

    >>> patient_in_name("P04_v1"), patient_in_name("P06_followup"), patient_in_name("P05_left")
    ('P04', 'P06', 'P05')
    """
    without_side = side_in_name(case_id)[1]
    return _VISIT.sub("", without_side).strip("._ -") or case_id


def likely_patients(patients: Mapping[str, str]) -> dict[str, tuple[str, ...]]:
    """Cases whose ids look like one patient's, but that count as different patients.

    Args:
        patients: Case id → patient, as the study knows it.

    Returns:
        The common part of the ids → the cases, where there are two or more.

    >>> likely_patients({name: name for name in ("P04_v1", "P04_v2", "P07")})
    {'P04': ('P04_v1', 'P04_v2')}
    """
    alike: dict[str, list[str]] = {}
    for case_id in patients:
        alike.setdefault(patient_in_name(case_id), []).append(case_id)
    return {
        name: tuple(cases)
        for name, cases in alike.items()
        if len(cases) > 1 and len({patients[case_id] for case_id in cases}) > 1
    }


def advice_on_patients(patients: Mapping[str, str]) -> str:
    """One sentence on ids that look like several cases of one patient; "" if there are none."""
    found = likely_patients(patients)
    if not found:
        return ""
    first = " and ".join(next(iter(found.values()))[:2])
    return (
        f"{len(found)} {'patient seems' if len(found) == 1 else 'patients seem'} to have several "
        f"cases ({first}), which count as different patients. If they are of one patient, name a "
        "table with the columns case and patient in data.patients"
    )

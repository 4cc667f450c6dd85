"""Cases that were withdrawn from a run, identified by the hashes of their files."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from ssm_pipeline import storage
from ssm_pipeline.counting import counted
from ssm_pipeline.engine.keys import key_of_files
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.records import Cohort, DamagedFile, StudyError

WITHDRAWN_FILE = "withdrawn.json"


def withdrawn_keys(run_folder: Path) -> list[str]:
    """Return the hashes of withdrawn cases.

    Raises:
        StudyError: If the file is damaged: without it, withdrawn cases would be used again.
    """
    path = run_folder / WITHDRAWN_FILE
    if not path.is_file():
        return []
    try:
        keys = storage.read_json(path)
        if isinstance(keys, list) and all(isinstance(key, str) for key in keys):
            return keys
        what = "holds no list of hashes"
    except DamagedFile as error:
        what = error.found
    raise StudyError(
        f"{path} {what}. It lists the cases that were withdrawn from this run, so the run can't "
        "start without it. Restore it from a backup, or remove those cases from the data folder "
        "and delete the file."
    )


def withdraw(run_folder: Path, file_key: str) -> None:
    """Leave a case with these files out of all later runs in this folder."""
    keys = sorted({*withdrawn_keys(run_folder), file_key})
    storage.write_json(run_folder / WITHDRAWN_FILE, keys)


def without_withdrawn(
    cohort: Cohort, run_folder: Path, terminal: Terminal
) -> tuple[Cohort, dict[str, str]]:
    """Return the cohort without withdrawn cases, and the key of each case's files."""
    keys = {case.case_id: key_of_files(case.files) for case in cohort.cases}
    withdrawn = set(withdrawn_keys(run_folder)) & set(keys.values())
    if withdrawn:
        noun = counted(len(withdrawn), "case was withdrawn and is", "cases were withdrawn and are")
        terminal.detail(f"{noun} left out")
        keys = {case_id: key for case_id, key in keys.items() if key not in withdrawn}
        kept = tuple(case for case in cohort.cases if case.case_id in keys)
        cohort = dataclasses.replace(cohort, cases=kept)
    return cohort, keys

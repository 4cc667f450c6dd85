"""Cases withdrawn from a run for good: known by the hash of their files, not by their names."""

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
    """Raises StudyError for a damaged file: without it, whoever withdrew would be taken back."""
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
        f"{path} {what}. It says which cases were withdrawn from this run, so nothing is run "
        "without it. Copy it from a backup; or take those cases out of the data's folder, then "
        "delete it."
    )


def withdraw(run_folder: Path, file_key: str) -> None:
    """From now on, a case with these files is left out of this run."""
    keys = sorted({*withdrawn_keys(run_folder), file_key})
    storage.write_json(run_folder / WITHDRAWN_FILE, keys)


def without_withdrawn(
    cohort: Cohort, run_folder: Path, terminal: Terminal
) -> tuple[Cohort, dict[str, str]]:
    """The cohort without those withdrawn, and the key of each case's files."""
    keys = {case.case_id: key_of_files(case.files) for case in cohort.cases}
    withdrawn = set(withdrawn_keys(run_folder)) & set(keys.values())
    if withdrawn:
        noun = counted(len(withdrawn), "case was withdrawn and is", "cases were withdrawn and are")
        terminal.detail(f"{noun} left out")
        keys = {case_id: key for case_id, key in keys.items() if key not in withdrawn}
        kept = tuple(case for case in cohort.cases if case.case_id in keys)
        cohort = dataclasses.replace(cohort, cases=kept)
    return cohort, keys

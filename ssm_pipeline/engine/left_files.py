"""List the files that a stage wrote, and find those that have changed since.

A case's `case.json` lists the files beside it. `stage.json` lists all other files of the stage's
folder, including each `case.json`.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from ssm_pipeline import storage
from ssm_pipeline.records import DamagedFile

CASE_FILE, STAGE_FILE = "case.json", "stage.json"


def files_of_case(folder: Path) -> Iterator[Path]:
    """Yield all files in a case's folder except its own record."""
    return (path for path in _files_below(folder) if path != folder / CASE_FILE)


def files_of_stage(folder: Path) -> Iterator[Path]:
    """Yield a stage's files, except its own record and the files that a `case.json` lists."""
    for path in _files_below(folder):
        owners = (parent / CASE_FILE for parent in path.parents if parent.is_relative_to(folder))
        if path.name == CASE_FILE or not any(owner.exists() for owner in owners):
            if path != folder / STAGE_FILE:
                yield path


def damaged_files(
    folder: Path, written: storage.Fingerprints, by_content: bool = False
) -> list[DamagedFile]:
    """Return the files of a stage and of its cases that have changed since they were written."""
    found = storage.not_as_written(folder, written, by_content)
    bad = {error.path for error in found}
    for path in (folder / name for name in written if Path(name).name == CASE_FILE):
        if path in bad:
            continue
        try:
            of_case = storage.read_json(path).get("files", {})
            found += storage.not_as_written(path.parent, of_case, by_content)
        except (DamagedFile, AttributeError, TypeError, ValueError):
            found.append(DamagedFile(path, "has changed since it was written"))
    return found


def undo(path: Path, run_folder: Path) -> None:
    """Delete a damaged file and the records that list it, so that it is made again.

    Paths outside the run's folder, which a damaged record may contain, are not touched.
    """
    path = Path(os.path.normpath(path))  # without "..", but with the user's own links
    if not path.is_relative_to(run_folder):
        return
    storage.remove(path)
    for parent in path.parents:
        if parent == run_folder or not parent.is_relative_to(run_folder):
            return
        for record in (CASE_FILE, STAGE_FILE):
            storage.remove(parent / record)


def _files_below(folder: Path) -> Iterator[Path]:
    """Yield the files below a folder, without hidden ones: those are unfinished writes."""
    return (path for path in folder.rglob("*") if path.is_file() and path.name[0] != ".")

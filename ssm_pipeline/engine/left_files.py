"""Which files a stage and its cases left, and which of them are no longer as they were written.

A case's `case.json` answers for the files beside it, `stage.json` for the rest of the stage's
folder, the `case.json`s among them.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from ssm_pipeline import storage
from ssm_pipeline.records import DamagedFile

CASE_FILE, STAGE_FILE = "case.json", "stage.json"


def files_of_case(folder: Path) -> Iterator[Path]:
    """All that lies in a case's folder but its own record."""
    return (path for path in _files_below(folder) if path != folder / CASE_FILE)


def files_of_stage(folder: Path) -> Iterator[Path]:
    """All that lies in a stage's folder, but what a `case.json` answers for and its own record."""
    for path in _files_below(folder):
        owners = (parent / CASE_FILE for parent in path.parents if parent.is_relative_to(folder))
        if path.name == CASE_FILE or not any(owner.exists() for owner in owners):
            if path != folder / STAGE_FILE:
                yield path


def damaged_files(
    folder: Path, written: storage.Fingerprints, by_content: bool = False
) -> list[DamagedFile]:
    """What is not as a stage left it: of its own files, and of its cases'."""
    found = storage.not_as_written(folder, written, by_content)
    bad = {error.path for error in found}
    for path in (folder / name for name in written if Path(name).name == CASE_FILE):
        if path in bad:
            continue
        try:
            of_case = storage.read_json(path).get("files", {})
            found += storage.not_as_written(path.parent, of_case, by_content)
        except (DamagedFile, AttributeError, TypeError, ValueError):
            found.append(DamagedFile(path, "no longer holds what was written"))
    return found


def undo(path: Path, run_folder: Path) -> None:
    """Delete a damaged file and the records that call it finished, so that it is made again.

    A path outside the run's folder, which a damaged record may name, is left alone.
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
    """Hidden ones are other processes' unfinished writing."""
    return (path for path in folder.rglob("*") if path.is_file() and path.name[0] != ".")

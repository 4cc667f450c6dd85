"""Whose results a run folder holds: two studies never mix in one, nor two runs at a time."""

from __future__ import annotations

import shutil
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from ssm_pipeline import storage
from ssm_pipeline.engine.left_files import CASE_FILE, STAGE_FILE
from ssm_pipeline.engine.run_log import read_events
from ssm_pipeline.engine.stage import StageRecord
from ssm_pipeline.records import DamagedFile, StudyError

OWNER_FILE = "study.json"
LOCK_FILE = ".lock"


@contextmanager
def alone_in(run_folder: Path) -> Iterator[None]:
    """Hold the folder's lock, which the system releases however the process ends.

    Raises:
        StudyError: If another process holds it.
    """
    run_folder.parent.mkdir(parents=True, exist_ok=True)
    # Beside the folder, not in it: the folder itself may be moved aside.
    lock = FileLock(run_folder.with_name(f"{LOCK_FILE}-{run_folder.name}"))
    try:
        lock.acquire(timeout=0)
    except Timeout as error:
        raise StudyError(
            f"another process is running {run_folder}. Wait for it, or choose another folder "
            "with --runs."
        ) from error
    try:
        yield
    finally:
        lock.release()


def make_room(run_folder: Path, study: str, is_synthetic: bool) -> Path | None:
    """Check that the folder is this study's, before anything is written to it.

    Phantom results give way to patients': they are moved to `<study>-phantoms`, and that path is
    returned.

    Raises:
        StudyError: For a folder of another study, or of patients when phantoms run.
    """
    owner = read_owner(run_folder)
    if owner is None:
        ours = ("data", OWNER_FILE, "study.yaml")  # of a run that was stopped as it began
        names = [path.name for path in run_folder.glob("*")]
        strangers = [name for name in names if name not in ours and not name.startswith(".")]
        if strangers:
            raise StudyError(
                f"{run_folder} holds files that are no run of this program ({strangers[0]}). "
                "Choose another folder with --runs."
            )
        return None
    if owner["study"] != study:
        raise StudyError(
            f"{run_folder} belongs to the study {owner['study']}, not {study}. Choose another "
            "folder with --runs."
        )
    if is_synthetic and not owner["synthetic"]:
        raise StudyError(
            f"{run_folder} holds results of {owner['data']}; this run has no masks and would put "
            "synthetic phantoms in their place. Pass --data, or choose another folder with --runs."
        )
    if is_synthetic or not owner["synthetic"]:
        return None
    aside = run_folder.with_name(f"{run_folder.name}-phantoms")
    if aside.exists():
        raise StudyError(
            f"{run_folder} holds results of synthetic phantoms, and {aside} exists too. Delete "
            "one of them, or choose another folder with --runs."
        )
    run_folder.rename(aside)
    return aside


def read_owner(run_folder: Path) -> dict[str, Any] | None:
    """Whose the folder is: study, synthetic, data, cases (id → file key); None if no run was here.

    Where the file that says so is damaged or missing, the run's log and records say it.

    Raises:
        StudyError: Where they don't either.
    """
    path = run_folder / OWNER_FILE
    record = StageRecord.read(run_folder / "data")
    cases = record.inputs if record is not None else {}
    for content in _said_of_the_owner(run_folder):
        try:
            return {"cases": cases} | _owner(content)
        except (KeyError, TypeError):
            continue
    if not any(run_folder.glob(f"*/{STAGE_FILE}")):
        return None  # nothing is finished here
    raise StudyError(
        f"{path} is missing or damaged, and nothing else says whose results {run_folder} "
        "holds. Move it away and run again."
    )


def _said_of_the_owner(run_folder: Path) -> Iterator[Any]:
    """What the owner's file says, then what the log does, the latest first."""
    with suppress(DamagedFile):
        yield storage.read_json(run_folder / OWNER_FILE)
    yield from reversed([one for one in read_events(run_folder) if one["event"] == "run"])


def _owner(content: Any) -> dict[str, Any]:
    """Raises KeyError or TypeError for what no run wrote."""
    kinds = {"study": str, "synthetic": bool, "data": str}
    kinds |= {"cases": dict} if "cases" in content else {}
    owner = {name: content[name] for name in kinds}
    fits = all(isinstance(owner[name], kind) for name, kind in kinds.items())
    if not fits or not all(isinstance(key, str) for key in owner.get("cases", {}).values()):
        raise TypeError("these are not the names and hashes that a run writes")
    return owner


def take(
    run_folder: Path, study: str, data: str, is_synthetic: bool, file_keys: Mapping[str, str]
) -> tuple[str, ...]:
    """Write down whose the folder is.

    Cases may be added to a study or left out: one mask in common is enough. What there is of cases
    left out is deleted; their ids are returned.

    Raises:
        StudyError: If it holds results of other masks.
    """
    owner = read_owner(run_folder)
    before: Mapping[str, str] = owner["cases"] if owner else {}
    if owner and before and not is_synthetic and not set(before.values()) & set(file_keys.values()):
        raise StudyError(
            f"{run_folder} holds results of {owner['data']}; this run is on {data}, none of "
            f"which is among them. Choose another folder with --runs, or delete {run_folder}."
        )
    gone = tuple(sorted(set(before) - set(file_keys)))
    delete_cases(run_folder, gone)
    content = {"study": study, "synthetic": is_synthetic, "data": data, "cases": dict(file_keys)}
    storage.write_json(run_folder / OWNER_FILE, content)
    return gone


def delete_cases(run_folder: Path, case_ids: Collection[str]) -> None:
    """Delete the folders of these cases in every stage."""
    if not case_ids:
        return
    for record in [*run_folder.glob(f"*/**/{CASE_FILE}")]:
        if record.parent.name in case_ids:
            shutil.rmtree(record.parent)

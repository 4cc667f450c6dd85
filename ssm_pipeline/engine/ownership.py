"""Record which study a run folder belongs to, and let one run at a time write to it."""

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
    # The lock lies beside the folder, because the folder itself may be moved.
    lock = FileLock(run_folder.with_name(f"{LOCK_FILE}-{run_folder.name}"))
    try:
        lock.acquire(timeout=0)
    except Timeout as error:
        raise StudyError(
            f"another process is writing to {run_folder}. Wait until it ends, or choose another "
            "folder with --runs."
        ) from error
    try:
        yield
    finally:
        lock.release()


def make_room(run_folder: Path, study: str, is_synthetic: bool) -> Path | None:
    """Check that the folder belongs to this study, before anything is written to it.

    If patients are run and the folder holds results of phantoms, these are moved to
    `<study>-phantoms`, and that path is returned.

    Raises:
        StudyError: If the folder belongs to another study, or phantoms are run and it holds
            results of patients.
    """
    owner = read_owner(run_folder)
    if owner is None:
        ours = ("data", OWNER_FILE, "study.yaml")  # left by a run that stopped early
        names = [path.name for path in run_folder.glob("*")]
        strangers = [name for name in names if name not in ours and not name.startswith(".")]
        if strangers:
            raise StudyError(
                f"{run_folder} holds files that do not belong to a run (such as {strangers[0]}). "
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
            f"{run_folder} holds results of {owner['data']}. This run has no masks and would "
            "replace them by synthetic phantoms. Pass --data, or choose another folder with --runs."
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
    """Return the folder's owner: study, synthetic, data, cases (id → file key).

    If the owner file is damaged or missing, the owner is read from the run's log and records.

    Returns:
        None if the folder holds no run.

    Raises:
        StudyError: If the log and records do not contain the owner either.
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
        f"{path} is missing or damaged, and the log does not say which study the results in "
        f"{run_folder} belong to. Move that folder away and run again."
    )


def _said_of_the_owner(run_folder: Path) -> Iterator[Any]:
    """Yield the content of the owner file, then the log's entries, the latest first."""
    with suppress(DamagedFile):
        yield storage.read_json(run_folder / OWNER_FILE)
    yield from reversed([one for one in read_events(run_folder) if one["event"] == "run"])


def _owner(content: Any) -> dict[str, Any]:
    """Return a checked owner. Raises KeyError or TypeError for content that no run writes."""
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
    """Write the folder's owner.

    Cases may be added to a study or left out: one mask in common is enough. The results of cases
    that were left out are deleted, and their ids are returned.

    Raises:
        StudyError: If the folder holds results of other masks.
    """
    owner = read_owner(run_folder)
    before: Mapping[str, str] = owner["cases"] if owner else {}
    if owner and before and not is_synthetic and not set(before.values()) & set(file_keys.values()):
        raise StudyError(
            f"{run_folder} holds results of {owner['data']}, but this run uses {data}; they have "
            f"no case in common. Choose another folder with --runs, or delete {run_folder}."
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

"""Whose results a run folder holds: two studies never mix in one, nor two runs at a time."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from ssm_pipeline import storage
from ssm_pipeline.engine.stage import StageRecord
from ssm_pipeline.records import StudyError

OWNER_FILE = "study.json"
LOCK_FILE = ".lock"


@contextmanager
def alone_in(run_folder: Path) -> Iterator[None]:
    """Hold the folder's lock, which the system releases however the process ends.

    Raises StudyError if another process holds it.
    """
    run_folder.parent.mkdir(parents=True, exist_ok=True)
    # Beside the folder, not in it: the folder itself may be moved aside.
    with run_folder.with_name(f"{LOCK_FILE}-{run_folder.name}").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise StudyError(
                f"another process is running {run_folder}. Wait for it, or choose another folder "
                "with --runs."
            ) from error
        yield


def make_room(run_folder: Path, study: str, is_synthetic: bool) -> Path | None:
    """Check that the folder is this study's, before anything is written to it.

    Phantom results give way to patients': they are moved to `<study>-phantoms`, and that path is
    returned. Raises StudyError for a folder of another study, or of patients when phantoms run.
    """
    owner_path = run_folder / OWNER_FILE
    if not owner_path.exists():
        strangers = [path.name for path in run_folder.glob("*") if path.name != "data"]
        if strangers:
            raise StudyError(
                f"{run_folder} holds files that are no run of this program ({strangers[0]}). "
                "Choose another folder with --runs."
            )
        return None
    owner = storage.read_json(owner_path)
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


def take(
    run_folder: Path, study: str, data: str, is_synthetic: bool, file_keys: Mapping[str, str]
) -> None:
    """Write down whose the folder is. Raises StudyError if it holds results of other masks.

    Cases may be added to a study or left out: one mask in common is enough.
    """
    before = StageRecord.read(run_folder / "data")
    if before is not None and not is_synthetic:
        if not set(before.inputs.values()) & set(file_keys.values()):
            owner = storage.read_json(run_folder / OWNER_FILE)
            raise StudyError(
                f"{run_folder} holds results of {owner['data']}; this run is on {data}, none of "
                f"which is among them. Choose another folder with --runs, or delete {run_folder}."
            )
    owner = {"study": study, "synthetic": is_synthetic, "data": data}
    storage.write_json(run_folder / OWNER_FILE, owner)

"""Files of earlier exports in a folder, and the folders a run was exported to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ssm_pipeline import storage

EXPORTS_FILE = "exports.json"


def clear_former_model(
    folder: Path, before: Mapping[str, Any], model_key: str, written: Sequence[Path]
) -> list[str]:
    """Delete the files of another model that an earlier export wrote.

    Args:
        before: The content of the folder's `export.json` before this export.
        model_key: The key of the model that is exported now.

    Returns:
        The names of this program's files in the folder, for the new `export.json`.
    """
    now = {path.relative_to(folder).as_posix() for path in written}
    former = set(before.get("files", ())) - now
    if before.get("model_key") == model_key:
        return sorted(former | now)
    for name in former:
        path = folder / name
        if path.resolve().is_relative_to(folder.resolve()):
            storage.remove(path)
    return sorted(now)


def note_export(run_folder: Path, folder: Path) -> None:
    """Record a folder that a run was exported to, so that `workflow forget` can list it."""
    path = run_folder / EXPORTS_FILE
    known = storage.read_json(path) if path.is_file() else []
    if str(folder.resolve()) not in known:
        storage.write_json(path, sorted({*known, str(folder.resolve())}))


def exports_of(run_folder: Path) -> tuple[Path, ...]:
    """Return the existing folders that a run was exported to."""
    path = run_folder / EXPORTS_FILE
    known = storage.read_json(path) if path.is_file() else []
    return tuple(Path(name) for name in known if Path(name).exists())

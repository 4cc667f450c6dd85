"""Find and read a study: a YAML file and the options `--set` and `--data`, checked key by key."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.records import StudyError
from ssm_pipeline.study.settings import StudySettings
from ssm_pipeline.study.yaml_settings import checked_as, merge, nearest, parse_changes, read_yaml

WITHOUT_DATA = "without_data"  # section of overrides for a run that is given no masks


@dataclass(frozen=True)
class Study:
    """A study as it will run. `is_stand_in`: phantoms replace masks that were not given."""

    name: str
    path: Path
    settings: StudySettings
    is_stand_in: bool = False

    def announce(self, terminal: Terminal) -> None:
        """Print a warning if phantoms replace patients, so that nobody mistakes them."""
        if self.is_stand_in:
            terminal.say(
                f"{self.name}: no masks were given (--data FOLDER), so the run uses SYNTHETIC "
                "PHANTOMS: made-up organs, not patients, and fewer than a study needs."
            )


def study_folders() -> list[Path]:
    """Folders in which a study's name is searched, in this order: here, ./workflows, built-in."""
    package = Path(str(files("ssm_pipeline")))
    built_in = [package / "workflows", package.parent / "workflows"]  # a wheel; a checkout
    return [Path(), Path("workflows"), *[folder for folder in built_in if folder.is_dir()]]


def study_paths() -> dict[str, Path]:
    """Name → YAML of every study that a name finds (not those of the current directory)."""
    found: dict[str, Path] = {}
    for folder in study_folders()[1:]:
        for path in sorted(folder.glob("*.yaml")):
            found.setdefault(path.stem, path)
    return found


def find_study(name: str) -> Path:
    """The YAML of a study's name, or the path itself.

    Raises:
        StudyError: If there is no such study; the message names the nearest.
    """
    if name.endswith((".yaml", ".yml")):
        if not Path(name).is_file():
            raise StudyError(f"there is no file {name}. Give the name or the YAML file of a study.")
        return Path(name)
    for folder in study_folders():
        if (folder / f"{name}.yaml").is_file():
            return folder / f"{name}.yaml"
    known = sorted(study_paths())
    raise StudyError(
        f"there is no study {name}.{nearest(name, known)} `workflow init` writes a new one."
    )


def read_study(name: str, data: Path | None = None, changes: Sequence[str] = ()) -> Study:
    """Read a study by name or path, with masks from `data` and `--set` changes (`a.b=value`).

    Raises:
        StudyError: For an unknown study or key, a value out of range, or cases not given.
    """
    path = find_study(name)
    content = read_yaml(path)
    stand_in = content.pop(WITHOUT_DATA, None)
    if stand_in is not None and not isinstance(stand_in, Mapping):
        raise StudyError(
            f"{path}: {WITHOUT_DATA} must be a section of settings. Indent its settings below it."
        )
    over = [{"data": {"folder": str(data)}}] if data is not None else []
    over += parse_changes(changes)
    changed = functools.reduce(merge, over, content)
    if not isinstance(content.get("data"), Mapping) or not isinstance(changed["data"], Mapping):
        raise StudyError(
            f"{path}: a section `data` is needed, with `source: masks`, meshes or luna16."
        )
    is_stand_in = (
        changed["data"].get("source") != "phantoms" and changed["data"].get("folder") is None
    )
    if is_stand_in:
        if stand_in is None:
            noun = "surfaces" if changed["data"].get("source") == "meshes" else "masks"
            raise StudyError(
                f"study {path.stem} needs {noun}. Pass --data FOLDER, or set data.folder in {path}."
            )
        # The changes are applied again last, because the command line overrides the file.
        changed = functools.reduce(merge, [stand_in, *over], content)
    return Study(path.stem, path, checked(changed, path), is_stand_in)


def read_run_settings(run_folder: Path, changes: Sequence[str] = ()) -> StudySettings:
    """Return a run's settings with `--set` changes applied. Raises StudyError."""
    path = run_folder / "study.yaml"
    if not path.is_file():
        raise StudyError(f"{run_folder} holds no run; give a folder such as runs/luna16.")
    return checked(functools.reduce(merge, parse_changes(changes), read_yaml(path)), path)


def checked(content: Mapping[str, Any], path: Path) -> StudySettings:
    return checked_as(StudySettings, content, path)

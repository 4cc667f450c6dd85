"""Find and read a study: a YAML file, `--set` and `--data` over it, checked key by key."""

from __future__ import annotations

import difflib
import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import ValidationError

from ssm_pipeline.pipeline.known_keys import known_keys
from ssm_pipeline.pipeline.settings import StudySettings
from ssm_pipeline.pipeline.terminal import Terminal
from ssm_pipeline.records import StudyError
from ssm_pipeline.settings import Settings

Kind = TypeVar("Kind", bound=Settings)
WITHOUT_DATA = "without_data"  # section of overrides for a run that is given no masks


@dataclass(frozen=True)
class Study:
    """A study as it will run. `is_stand_in`: phantoms take the place of the masks not given."""

    name: str
    path: Path
    settings: StudySettings
    is_stand_in: bool = False

    def announce(self, terminal: Terminal) -> None:
        """Say so where phantoms stand in: they are never to be taken for patients."""
        if self.is_stand_in:
            terminal.say(
                f"{self.name}: no masks given (--data FOLDER). SYNTHETIC PHANTOMS stand in for "
                "them: made-up organs, not patients, and fewer of them than a study needs."
            )


def study_folders() -> list[Path]:
    """Where a study's name is looked for, nearest first: here, ./workflows, the built-in ones."""
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
    """The YAML of a study's name, or the path itself. Raises StudyError, naming the nearest."""
    if name.endswith((".yaml", ".yml")):
        if not Path(name).is_file():
            raise StudyError(f"there is no file {name}. Give a study's name or its YAML.")
        return Path(name)
    for folder in study_folders():
        if (folder / f"{name}.yaml").is_file():
            return folder / f"{name}.yaml"
    known = sorted(study_paths())
    raise StudyError(
        f"there is no study {name}.{_nearest(name, known)} Known: {', '.join(known)}. "
        "`workflow init` writes a new one."
    )


def read_study(name: str, data: Path | None = None, changes: Sequence[str] = ()) -> Study:
    """Read a study by name or path, with masks from `data` and `--set` changes (`a.b=value`).

    Raises StudyError for an unknown study or key, a value out of range, or masks not given.
    """
    path = find_study(name)
    content = read_yaml(path)
    stand_in = content.pop(WITHOUT_DATA, None)
    section = content.get("data")
    if not isinstance(section, Mapping):
        raise StudyError(f"{path}: a section `data` is needed, with `source: masks` or luna16.")
    over = [{"data": {"folder": str(data)}}] if data is not None else []
    over += [parse_change(change) for change in changes]
    changed = functools.reduce(merge, over, content)
    is_stand_in = (
        changed["data"].get("source") != "phantoms" and changed["data"].get("folder") is None
    )
    if is_stand_in:
        if stand_in is None:
            raise StudyError(
                f"study {path.stem} needs masks. Pass --data FOLDER, or set data.folder in {path}."
            )
        # Changes come last again: what the user asks for counts over the file.
        changed = functools.reduce(merge, [stand_in, *over], content)
    return Study(path.stem, path, checked(changed, path), is_stand_in)


def read_run_settings(run_folder: Path, changes: Sequence[str] = ()) -> StudySettings:
    """The settings a run was made with, with `--set` changes over them. Raises StudyError."""
    path = run_folder / "study.yaml"
    if not path.is_file():
        raise StudyError(f"{run_folder} holds no run; give a folder such as runs/luna16.")
    return checked(functools.reduce(merge, map(parse_change, changes), read_yaml(path)), path)


def read_yaml(path: Path) -> dict[str, Any]:
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise StudyError(f"{path} is not readable as YAML: {error}") from error
    if not isinstance(content, dict):
        raise StudyError(f"{path} holds no settings; `workflow init` writes a file to start from.")
    return content


def parse_change(change: str) -> dict[str, Any]:
    """`training.steps=2000` → {"training": {"steps": 2000}}; the value is read as YAML."""
    key, equals, text = change.partition("=")
    names = key.strip().split(".")
    if not equals or not all(names):
        raise StudyError(f"--set {change}: section.name=value is needed, as training.steps=2000.")
    try:
        value = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise StudyError(f"--set {change}: the value is not readable as YAML: {error}") from error
    for name in reversed(names):
        value = {name: value}
    return value


def merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """`over` laid over `base`, section by section. A new `source` starts its section afresh."""
    merged = dict(base)
    for name, value in over.items():
        old = merged.get(name)
        if isinstance(value, Mapping) and isinstance(old, Mapping):
            replaced = "source" in value and value["source"] != old.get("source")
            merged[name] = dict(value) if replaced else merge(old, value)
        else:
            merged[name] = value
    return merged


def checked(content: Mapping[str, Any], path: Path) -> StudySettings:
    return checked_as(StudySettings, content, path)


def checked_as(kind: type[Kind], content: Mapping[str, Any], path: Path) -> Kind:
    """Settings of a class from a file's content. Raises StudyError, a line a problem."""
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        known = known_keys(kind)
        lines = []
        for problem in error.errors():
            # The discriminator of `data` appears in the location; it is no key of the file.
            where = [str(part) for part in problem["loc"]]
            if where[:1] == ["data"] and where[1:2] and where[1] in ("luna16", "masks", "phantoms"):
                section, where = f"data:{where[1]}", ["data", *where[2:]]
            else:
                section = ".".join(where[:-1])
            if problem["type"] == "extra_forbidden":
                near = _nearest(where[-1], known.get(section, ()))
                lines.append(f"there is no setting {'.'.join(where)}.{near}")
            elif problem["type"] == "value_error":  # of ours: says itself what was found
                place = f"{'.'.join(where)}: " if where else ""
                lines.append(f"{place}{problem['ctx']['error']}")
            else:
                lines.append(f"{'.'.join(where)}: {problem['msg']}; found {problem['input']!r}")
        raise StudyError(f"{path}: " + "\n  ".join(lines)) from error


def _nearest(name: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f" Did you mean {near[0]}?" if near else f" Known here: {', '.join(known)}."

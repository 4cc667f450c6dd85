"""Read settings from YAML, merge them, and check them key by key."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import ValidationError

from ssm_pipeline.records import StudyError
from ssm_pipeline.settings import Settings
from ssm_pipeline.study.known_keys import known_keys
from ssm_pipeline.study.settings_loader import SettingsLoader

Kind = TypeVar("Kind", bound=Settings)


def read_yaml(path: Path) -> dict[str, Any]:
    """A file's settings.

    Raises:
        StudyError: If the file is not YAML, or gives a key twice.
    """
    try:
        content = yaml.load(path.read_text(encoding="utf-8"), Loader=SettingsLoader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise StudyError(f"{path} can't be read as YAML: {error}") from error
    if not isinstance(content, dict):
        raise StudyError(f"{path} holds no settings; `workflow init` writes a file to start from.")
    return content


def changed_key(change: str) -> str:
    """`training.steps = 2000` → `training.steps`."""
    return change.partition("=")[0].strip()


def parse_change(change: str) -> dict[str, Any]:
    """`training.steps=2000` → {"training": {"steps": 2000}}; the value is read as YAML."""
    _, equals, text = change.partition("=")
    names = changed_key(change).split(".")
    if not equals or not all(names):
        raise StudyError(
            f"--set {change}: write it as section.name=value, such as training.steps=2000."
        )
    try:
        value = yaml.load(text, Loader=SettingsLoader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise StudyError(f"--set {change}: the value can't be read as YAML: {error}") from error
    for name in reversed(names):
        value = {name: value}
    result: dict[str, Any] = value
    return result


def parse_changes(changes: Sequence[str]) -> list[dict[str, Any]]:
    """Parse each change with `parse_change`.

    Raises:
        StudyError: If two change the same setting.
    """
    keys = [changed_key(change) for change in changes]
    if twice := next((key for key in keys if keys.count(key) > 1), None):
        raise StudyError(f"--set {twice} is given twice; give each setting once.")
    return [parse_change(change) for change in changes]


def merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Merge `over` into `base`, section by section. A new `source` replaces its section."""
    merged = dict(base)
    for name, value in over.items():
        old = merged.get(name)
        if isinstance(value, Mapping) and isinstance(old, Mapping):
            replaced = "source" in value and value["source"] != old.get("source")
            merged[name] = dict(value) if replaced else merge(old, value)
        else:
            merged[name] = value
    return merged


def checked_as(kind: type[Kind], content: Mapping[str, Any], path: Path) -> Kind:
    """Settings of a class from a file's content.

    Raises:
        StudyError: With one line per problem.
    """
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        known = known_keys(kind)
        lines = []
        for problem in error.errors():
            # The discriminator of `data` appears in the location; it is no key of the file.
            where = [str(part) for part in problem["loc"]]
            if ":".join(where[:2]) in known and where[:1] == ["data"]:
                section, where = f"data:{where[1]}", ["data", *where[2:]]
            else:
                section = ".".join(where[:-1])
            if problem["type"] == "extra_forbidden":
                near = nearest(where[-1], known.get(section, ()))
                lines.append(f"there is no setting {'.'.join(where)}.{near}")
            elif problem["type"] == "value_error":  # raised by our validators, with what was found
                place = f"{'.'.join(where)}: " if where else ""
                lines.append(f"{place}{problem['ctx']['error']}")
            else:
                wanted = problem["msg"].replace("a valid tuple", "a list, as [a, b]")
                lines.append(f"{'.'.join(where)}: {wanted}; found {problem['input']!r}")
        raise StudyError(f"{path}: " + "\n  ".join(lines)) from error


def nearest(name: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f" Did you mean {near[0]}?" if near else f" Known here: {', '.join(known)}."

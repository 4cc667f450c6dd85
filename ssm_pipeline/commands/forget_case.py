"""`workflow forget`: delete a case whose consent was withdrawn, with all results that used it.

Results that depend only on other cases stay: their meshes and bases. The trained networks, all
correspondences, the model, its scores and the report used the case and are deleted.
"""

from __future__ import annotations

import re
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from ssm_pipeline import storage
from ssm_pipeline.commands.export_folder import exports_of
from ssm_pipeline.commands.pseudonyms import forget_pseudonym
from ssm_pipeline.engine.left_files import CASE_FILE, STAGE_FILE
from ssm_pipeline.engine.ownership import OWNER_FILE, alone_in, delete_cases, read_owner
from ssm_pipeline.engine.run_log import EVENT_LOG, TEXT_LOG
from ssm_pipeline.engine.withdrawn import withdraw
from ssm_pipeline.records import StudyError
from ssm_pipeline.study.yaml_settings import read_yaml

OF_ONE_CASE_EACH = ("data", "meshing", "spectral")  # stages in which cases are independent
STALE_PAGE = """<!doctype html>
<meta charset="utf-8">
<title>Out of date</title>
<p>This report was deleted, because a case in it has been withdrawn.
Run the study again to make a new one.</p>
"""


@dataclass(frozen=True)
class Forgotten:
    """The deleted files of the run's folder, and exports elsewhere that still hold the case."""

    deleted: tuple[Path, ...]
    exports: tuple[Path, ...]


def forget_case(case_id: str, run_folder: Path) -> Forgotten:
    """Delete every trace of a case in a run's folder, and leave it out of later runs there.

    Its files are recognised by their hash, so that they are left out under any name.

    Raises:
        StudyError: If the folder holds no run, or the run has no such case.
    """
    owner = read_owner(run_folder)
    if owner is None:
        raise StudyError(f"{run_folder} holds no run; give a folder such as runs/luna16.")
    cases = dict(owner["cases"])
    if case_id not in cases:
        raise StudyError(
            f"{run_folder} has no case {case_id}. Its cases: {', '.join(cases) or 'none'}."
        )
    with alone_in(run_folder):
        withdraw(run_folder, cases.pop(case_id))
        before = {path for path in run_folder.rglob("*") if path.is_file()}
        delete_cases(run_folder, [case_id])
        for stage in run_folder.iterdir():
            if stage.is_dir():
                _forget_in_stage(stage, case_id)
        if (page := run_folder / "report" / "index.html") in before:
            storage.write_text(page, STALE_PAGE)
        forget_pseudonym(case_id, run_folder)
        _forget_in_settings(run_folder / "study.yaml", case_id)
        for name in (TEXT_LOG, EVENT_LOG):
            _forget_lines(run_folder / name, case_id)
        exports = exports_of(run_folder)
        storage.write_json(run_folder / OWNER_FILE, owner | {"cases": cases})
    after = {path for path in run_folder.rglob("*") if path.is_file()}
    return Forgotten(tuple(sorted(before - after)), exports)


def _forget_in_stage(stage: Path, case_id: str) -> None:
    if stage.name not in OF_ONE_CASE_EACH:
        shutil.rmtree(stage)
        return
    storage.remove(stage / STAGE_FILE)
    for path in stage.rglob("*"):
        of_cases = any((parent / CASE_FILE).exists() for parent in path.parents)
        if path.is_file() and not of_cases:  # tables of all cases; phantoms, drawn together
            storage.remove(path)


def _forget_in_settings(path: Path, case_id: str) -> None:
    """Delete a case from a file of settings: as template, in data.cases and in data.exclude."""
    if path.is_file() and case_id in path.read_text(encoding="utf-8", errors="replace"):
        left = without_value(read_yaml(path), case_id)
        data = left.get("data", {})
        if excluded := data.get("exclude"):
            data["exclude"] = {
                other: without_name(str(reason), case_id) for other, reason in excluded.items()
            }
        storage.write_text(path, yaml.safe_dump(left, sort_keys=False, allow_unicode=True))


def without_name(text: str, case_id: str) -> str:
    """A reason that names a withdrawn case, without its name.

    >>> without_name("a copy of a-1, not of a-12", "a-1")
    'a copy of a withdrawn case, not of a-12'
    """
    return re.sub(rf"(?<![\w-]){re.escape(case_id)}(?![\w-])", "a withdrawn case", text)


def without_value(settings: Any, value: str) -> Any:
    """Settings without the keys, and the entries of lists, that are or hold the value.

    >>> without_value({"template": "a", "data": {"cases": ["a", "b"], "exclude": {"a": "x"}}}, "a")
    {'data': {'cases': ['b'], 'exclude': {}}}
    """
    if isinstance(settings, dict):
        kept = {key: one for key, one in settings.items() if value not in (str(key), one)}
        return {key: without_value(one, value) for key, one in kept.items()}
    if isinstance(settings, list):
        return [without_value(one, value) for one in settings if one != value]
    return settings


def _forget_lines(path: Path, case_id: str) -> None:
    if path.is_file():
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines(keepends=True)
        storage.write_text(path, "".join(line for line in lines if case_id not in line))

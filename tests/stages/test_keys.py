"""Keys of stages and of cases: what a stage reads of the settings is in its key.

Which settings a stage reads is recorded in a run. A few settings are changed in real, too: the
second run's results then equal those of a run that starts without any file.
"""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK as sitk
from pydantic import BaseModel
from tiny_study import tiny_settings

from ssm_pipeline import storage
from ssm_pipeline.commands.run_study import run_study
from ssm_pipeline.engine import per_case
from ssm_pipeline.engine.keys import key_of
from ssm_pipeline.engine.left_files import CASE_FILE
from ssm_pipeline.engine.per_case import CaseResult, CaseTask
from ssm_pipeline.engine.runner import RunOptions
from ssm_pipeline.engine.stage import Outcome, Stage, StageContext, StageRecord
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.export.carried import markups
from ssm_pipeline.settings import Settings
from ssm_pipeline.stages import evaluation as evaluation_stage
from ssm_pipeline.stages.list import STAGES
from ssm_pipeline.study.settings import StudySettings

pytestmark = pytest.mark.filterwarnings("ignore:Pydantic serializer warnings")  # values of any type

NAMES = [stage.name for stage in STAGES]
Field = tuple[str, str]  # class of the settings, field

# The first stage whose key depends on a part of the settings; every later one depends on it, too,
# except for `spectral` to `report`, which do not read what the check of the cohort found.
FIRST = {
    "data": "data",
    "meshing": "meshing",
    "spectral": "spectral",
    "matching": "training",
    "training": "training",
    "adaptation": "correspondence",
    "template": "correspondence",
    "groupwise": "groupwise",
    "shape_model": "shape_model",
    "evaluation": "evaluation",
    "comparison": "evaluation",
    "report": "report",
}
EXCEPTIONS: dict[str, set[str]] = {
    "description": set(),
    "data.folder": set(),  # the files' content is in the key of the cases
    "training.faces": set(NAMES[NAMES.index("spectral") :]),
    "report.paths": set(NAMES[NAMES.index("correspondence") :]),
    "seed": set(NAMES[NAMES.index("cohort_check") :]) - {"spectral"},
}


def expected_stages(path: str) -> set[str]:
    if path in EXCEPTIONS:
        return EXCEPTIONS[path]
    first = NAMES.index(FIRST[path.partition(".")[0]])
    return set(NAMES[first:])


# Settings ------------------------------------------------------------------------------------


def fields_of(settings: BaseModel, before: str = "") -> Iterator[tuple[str, Field, Any]]:
    """Every field that holds no settings itself: path, where it is defined, value."""
    for name in type(settings).model_fields:
        value = getattr(settings, name)
        if isinstance(value, BaseModel):
            yield from fields_of(value, f"{before}{name}.")
        else:
            yield f"{before}{name}", (type(settings).__name__, name), value


def changed(settings: Any, path: str, value: Any) -> Any:
    name, _, rest = path.partition(".")
    inner = changed(getattr(settings, name), rest, value) if rest else value
    return settings.model_copy(update={name: inner})


def another(path: str, value: Any, folder: Path) -> Any:
    """Another value of the setting; not every one could be run."""
    content = markups(["tip", "base", "side"], 10 * np.eye(3))
    storage.write_json(folder / "landmarks.mrk.json", content)
    if path == "data.patients":
        (folder / "patients.csv").write_text("case,patient\nball_0,p\nball_1,p\n")
        return folder / "patients.csv"
    if path == "report.landmarks":
        return folder / "landmarks.mrk.json"
    if path == "evaluation.landmarks":
        return folder  # which holds the file above
    if path == "training.start":
        return "built-in"
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 1
    if isinstance(value, float):
        return value * 1.5 + 0.1
    if isinstance(value, tuple):
        return value[1:] if len(value) > 1 else (*value, *value, 5)
    if isinstance(value, Mapping):
        return {"ball_0": "not wanted"}
    return f"{value} changed"


def work_in(folder: Path, task: CaseTask) -> str:
    """What tells the work in a folder: the cases, or the scores of all."""
    return f"{folder.name}/scores" if task.case_id == "scores" else folder.name


def keys_of_stages(settings: StudySettings) -> dict[str, str]:
    keys: dict[str, str] = {}
    for stage in STAGES:
        inputs = {need: keys[need] for need in stage.needs}
        keys[stage.name] = key_of(stage.name, stage.version, stage.settings(settings), inputs)
    return keys


# A run that records what it reads ------------------------------------------------------------


@dataclasses.dataclass
class Recorded:
    """A finished run, what its stages and its work on cases read, and the stages' contexts."""

    folder: Path
    settings: StudySettings
    by_stages: set[tuple[str, Field]]
    by_cases: set[tuple[str, str, Field]]  # stage, work, field
    contexts: dict[str, StageContext[StudySettings]]


def write_two_labels(folder: Path) -> Path:
    """Ellipsoids of label 3 with a bump of label 5."""
    folder.mkdir()
    z, y, x = (np.indices((32, 32, 32)) - 16) * 2.5
    for index in range(4):
        a, b, c = 26 + 1.5 * index, 22 - 1.0 * index, 30 + 0.5 * index
        body = (x / a) ** 2 + (y / b) ** 2 + (z / c) ** 2 < 1
        bump = (x - 18) ** 2 + (y - 8) ** 2 + (z - 12) ** 2 < (11 + index) ** 2
        image = sitk.GetImageFromArray(np.where(body, 3, np.where(bump, 5, 0)).astype(np.uint8))
        image.SetSpacing((2.5, 2.5, 2.5))
        sitk.WriteImage(image, str(folder / f"ball_{index}.nii.gz"))
    return folder


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    folder = tmp_path_factory.mktemp("keys")
    settings = tiny_settings(write_two_labels(folder / "masks"), steps=2)
    comparison = settings.comparison.model_copy(update={"methods": ("adaptation only",)})
    groupwise = settings.groupwise.model_copy(update={"rounds": 1})
    settings = settings.model_copy(update={"comparison": comparison, "groupwise": groupwise})
    where: list[str] = []
    found = Recorded(folder / "runs" / "balls", settings, set(), set(), {})
    in_a_case: list[str] = []

    def read(self: Settings, name: str) -> Any:
        if where and name in type(self).model_fields:
            field = (type(self).__name__, name)
            found.by_stages.add((where[-1], field))
            if in_a_case:
                found.by_cases.add((where[-1], in_a_case[-1], field))
        return BaseModel.__getattribute__(self, name)

    def recording(stage: Stage[StudySettings]) -> Stage[StudySettings]:
        def work(context: StageContext[StudySettings]) -> Outcome:
            found.contexts[stage.name] = context
            where.append(stage.name)
            try:
                return stage.work(context)
            finally:
                where.pop()

        return dataclasses.replace(stage, work=work)

    real = per_case.run_case

    def run_case(task: CaseTask, stage_folder: Path, *arguments: Any) -> CaseResult:
        in_a_case.append(work_in(stage_folder, task))
        try:
            return real(task, stage_folder, *arguments)
        finally:
            in_a_case.pop()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Settings, "__getattribute__", read, raising=False)
        patch.setattr(per_case, "run_case", run_case)
        patch.setattr("ssm_pipeline.engine.workers.run_case", run_case)
        stages = [recording(stage) for stage in STAGES]
        run_study("balls", settings, RunOptions(folder / "runs"), Terminal(), stages)
    return found


def test_every_setting_changes_the_keys_of_the_stages_that_may_depend_on_it(
    recorded: Recorded, tmp_path: Path
) -> None:
    before = keys_of_stages(recorded.settings)
    wrong = {}
    for path, _, value in fields_of(recorded.settings):
        settings = changed(recorded.settings, path, another(path, value, tmp_path))
        after = keys_of_stages(settings)
        found = {name for name in NAMES if before[name] != after[name]}
        if found != expected_stages(path):
            wrong[path] = found ^ expected_stages(path)
    assert not wrong


def test_what_a_stage_reads_is_in_its_key(recorded: Recorded) -> None:
    paths = {field: path for path, field, _ in fields_of(recorded.settings)}
    assert len(recorded.by_stages) > 60
    wrong = {
        (stage, paths[field])
        for stage, field in recorded.by_stages
        if field in paths and stage not in expected_stages(paths[field])  # else: a whole section
    }
    assert not wrong


# The cases are found before the first stage runs, with these settings in them.
CHANGES_A_CASE = {"labels", "segments", "threshold", "unit", "mirror", "allow_truncated"}

# Keys of the cases ---------------------------------------------------------------------------


def keys_of_cases(
    recorded: Recorded, settings: StudySettings, last: str, patch: pytest.MonkeyPatch
) -> dict[str, dict[str, list[str]]]:
    """Stage → work → the keys of the cases there; no work on a case is done."""
    keys: dict[str, dict[str, list[str]]] = {}

    def map_cases(
        self: StageContext[StudySettings],
        tasks: Sequence[CaseTask],
        folder: Path | None = None,
        in_this_process: bool = False,
    ) -> list[CaseResult]:
        place = folder or self.folder()
        keys.setdefault(self.name, {})[work_in(place, tasks[0])] = [task.key for task in tasks]
        results = []
        for task in tasks:
            kept = storage.read_json(place / task.case_id / CASE_FILE)
            results.append(CaseResult(**{**kept, "key": task.key}))
        return results

    patch.setattr(StageContext, "map_cases", map_cases)
    patch.setattr("ssm_pipeline.cohort_check.check.twins", lambda *arguments: [])
    patch.setattr(evaluation_stage, "method_tables", lambda *arguments: {})
    patch.setattr(evaluation_stage, "model_tables", lambda *arguments: {})
    patch.setattr(evaluation_stage, "save_only", lambda *arguments: None)
    of_stages = keys_of_stages(settings)
    case_keys: Mapping[str, str] = recorded.contexts["data"].case_keys
    done: dict[str, StageRecord] = {}
    for stage in STAGES[: NAMES.index(last) + 1]:
        context = dataclasses.replace(
            recorded.contexts[stage.name],
            settings=settings,
            case_keys=case_keys,
            done=dict(done),
            key=of_stages[stage.name],
        )
        if stage.name not in ("training", "shape_model"):  # they work on no single case
            case_keys = stage.work(context).case_keys
        record = StageRecord.read(recorded.folder / stage.name)
        assert record is not None
        done[stage.name] = dataclasses.replace(
            record, key=of_stages[stage.name], case_keys=dict(case_keys)
        )
    return keys


def test_what_work_on_a_case_reads_is_in_the_key_of_the_case(
    recorded: Recorded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = tmp_path / "balls"
    shutil.copytree(recorded.folder, copy)
    contexts = {
        name: dataclasses.replace(context, run_folder=copy)
        for name, context in recorded.contexts.items()
    }
    recorded = dataclasses.replace(recorded, folder=copy, contexts=contexts)
    before = keys_of_cases(recorded, recorded.settings, "evaluation", monkeypatch)
    assert {*before} == {
        "meshing", "cohort_check", "spectral", "correspondence", "groupwise", "evaluation",
    }  # fmt: skip
    assert len(recorded.by_cases) > 40
    of_a_case = [("meshing", "meshing", ("MaskFolderData", name)) for name in CHANGES_A_CASE]
    read = {*recorded.by_cases, *of_a_case}
    kept = {}
    for path, field, value in fields_of(recorded.settings):
        places = {(stage, work) for stage, work, one in read if one == field}
        if not places:
            continue
        settings = changed(recorded.settings, path, another(path, value, tmp_path))
        last = max((stage for stage, _ in places), key=NAMES.index)
        after = keys_of_cases(recorded, settings, last, monkeypatch)
        for stage, work in places:
            if set(before[stage][work]) & set(after[stage][work]):
                kept[path] = (stage, work)
    assert not kept

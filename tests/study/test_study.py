"""Reading a study: every workflow parses; merging; refusals that name the nearest key."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from ssm_pipeline.engine.keys import key_of
from ssm_pipeline.records import StudyError
from ssm_pipeline.stages.list import STAGES
from ssm_pipeline.study.known_keys import known_keys
from ssm_pipeline.study.settings import StudySettings
from ssm_pipeline.study.sources import Luna16Data, PhantomData
from ssm_pipeline.study.study import read_study
from ssm_pipeline.study.yaml_settings import merge, parse_change

WORKFLOWS = sorted((Path(__file__).parents[2] / "workflows").glob("*.yaml"))


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_every_workflow_parses(path: Path, tmp_path: Path) -> None:
    study = read_study(str(path), data=None if path.stem == "phantoms" else tmp_path)
    assert study.name == path.stem
    assert study.settings.description
    assert not study.is_stand_in


def test_luna16_without_masks_runs_on_phantoms_with_its_own_overrides() -> None:
    study = read_study("luna16")
    assert study.is_stand_in
    assert isinstance(study.settings.data, PhantomData)
    given = read_study("luna16", data=Path("masks"))
    assert isinstance(given.settings.data, Luna16Data)
    assert given.settings.data.folder == Path("masks")
    assert study.settings.meshing.faces < given.settings.meshing.faces


def test_what_the_user_sets_counts_over_the_stand_in() -> None:
    changes = ["training.steps=3", "data.cases=4", "meshing.faces=700"]
    settings = read_study("luna16", changes=changes).settings
    assert (settings.training.steps, settings.data.cases, settings.meshing.faces) == (3, 4, 700)


def test_a_folder_that_is_set_is_a_folder_given() -> None:
    study = read_study("luna16", changes=["data.folder=/masks"])
    assert not study.is_stand_in
    assert isinstance(study.settings.data, Luna16Data)
    assert study.settings.data.folder == Path("/masks")


@pytest.mark.parametrize(
    ("change", "content"),
    [
        ("seed=3", {"seed": 3}),
        ("a.b.c=[1, 2]", {"a": {"b": {"c": [1, 2]}}}),
        ("a.b=null", {"a": {"b": None}}),
        ("a.b=x=y", {"a": {"b": "x=y"}}),
    ],
)
def test_a_change_is_read_as_yaml(change: str, content: dict[str, Any]) -> None:
    assert parse_change(change) == content


@pytest.mark.parametrize("change", ["seed", "=3", "a..b=1", "a.b=[1"])
def test_a_change_that_is_none_is_refused(change: str) -> None:
    with pytest.raises(StudyError, match="--set"):
        parse_change(change)


def test_merge_is_deep_and_leaves_its_arguments_alone() -> None:
    base = {"a": {"x": 1, "y": 2}, "b": 3}
    assert merge(base, {"a": {"y": 5}}) == {"a": {"x": 1, "y": 5}, "b": 3}
    assert base == {"a": {"x": 1, "y": 2}, "b": 3}
    assert merge(base, {}) == base


def test_another_source_starts_its_section_afresh() -> None:
    base = {"data": {"source": "luna16", "side": "left"}}
    assert merge(base, {"data": {"source": "phantoms"}}) == {"data": {"source": "phantoms"}}
    same = merge(base, {"data": {"source": "luna16", "limit": 3}})
    assert same == {"data": {"source": "luna16", "side": "left", "limit": 3}}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("trainig.steps=3", r"no setting trainig\. Did you mean training\?"),
        ("training.stps=3", r"no setting training\.stps\. Did you mean steps\?"),
        ("training.matching.temprature=1", r"training\.matching\.temprature\. Did you mean temp"),
        ("data.sides=left", r"no setting data\.sides\. Did you mean side\?"),
        ("data.side=top", r"data\.side: .*'left', 'right' or 'both'; found 'top'"),
        ("training.steps=-1", r"training\.steps: .*greater than or equal to 0; found -1"),
        ("meshing.zzz=0", r"no setting meshing\.zzz\. Known here: .*faces"),
    ],
)
def test_a_wrong_setting_is_named_with_where_and_what_is_near(change: str, message: str) -> None:
    with pytest.raises(StudyError, match=message):
        read_study("luna16", data=Path("masks"), changes=[change])


@pytest.mark.parametrize("text", ["", "just words", "a: [1", "seed: 3"])
def test_a_file_that_is_no_study_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "broken.yaml"
    path.write_text(text)
    with pytest.raises(StudyError, match=r"broken\.yaml"):
        read_study(str(path))


def test_an_unknown_study_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(StudyError, match=r"no study hipocampus\. Did you mean hippocampus\?"):
        read_study("hipocampus")
    with pytest.raises(StudyError, match="no file"):
        read_study("nowhere/study.yaml")


def test_known_keys_reach_every_section() -> None:
    known = known_keys(StudySettings)
    assert "steps" in known["training"]
    assert "temperature" in known["training.matching"]
    assert "side" in known["data:luna16"]
    assert "labels" in known["data:masks"]


def test_all_sections_are_frozen_and_refuse_unknown_keys() -> None:
    def models(model: type[BaseModel]) -> set[type[BaseModel]]:
        inner = {
            kind
            for field in model.model_fields.values()
            for kind in getattr(field.annotation, "__args__", (field.annotation,))
            if isinstance(kind, type) and issubclass(kind, BaseModel)
        }
        return {model}.union(*(models(kind) for kind in inner))

    found = models(StudySettings)
    assert len(found) >= 10
    for model in found:
        assert model.model_config.get("extra") == "forbid", model
        assert model.model_config.get("frozen"), model


def test_settings_survive_a_round_trip_through_yaml(tmp_path: Path) -> None:
    settings = read_study("luna16").settings
    path = tmp_path / "again.yaml"
    path.write_text(settings.to_yaml())
    assert read_study(str(path)).settings == settings


def phantom_seed(settings: StudySettings) -> int | None:
    assert isinstance(settings.data, PhantomData)
    return settings.data.seed


def test_phantoms_are_drawn_by_the_studys_seed_unless_they_have_their_own() -> None:
    assert phantom_seed(read_study("luna16").settings) == 0
    assert phantom_seed(read_study("luna16", changes=["seed=7"]).settings) == 7
    own = read_study("luna16", changes=["seed=7", "data.seed=3"]).settings
    assert (own.seed, phantom_seed(own)) == (7, 3)
    again = StudySettings.model_validate(own.model_dump())
    assert (again.seed, phantom_seed(again)) == (7, 3)


def test_every_stage_that_draws_rests_on_the_seed() -> None:
    """A stage whose settings do not change with the seed would be taken from the cache."""
    one, other = (read_study("luna16", changes=[f"seed={seed}"]).settings for seed in (0, 1))
    rests = {
        stage.name: key_of(stage.settings(one)) != key_of(stage.settings(other)) for stage in STAGES
    }
    drawing = ("data", "training", "correspondence", "groupwise", "evaluation")
    assert all(rests[name] for name in drawing), rests

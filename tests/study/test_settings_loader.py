"""YAML as settings need it: case ids stay text, keys come once, what is dumped is read back."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from ssm_pipeline.records import StudyError
from ssm_pipeline.study.settings import StudySettings
from ssm_pipeline.study.settings_loader import SettingsLoader
from ssm_pipeline.study.study import read_study
from ssm_pipeline.study.yaml_settings import checked_as, parse_change, parse_changes, read_yaml

DATA = {"source": "masks", "folder": "masks"}


@pytest.mark.parametrize("name", ["007", "NO", "yes", "1:30", "2020-01-01", "1e5", "0x10", "1_000"])
def test_what_is_not_plainly_a_number_stays_text(name: str) -> None:
    assert parse_change(f"template={name}") == {"template": name}
    assert StudySettings.model_validate({"data": DATA, "template": name}).template == name


@pytest.mark.parametrize(
    ("text", "value"),
    [("7", 7), ("-3", -3), ("0.5", 0.5), (".5", 0.5), ("true", True), ("null", None), ("", None)],
)
def test_numbers_truth_and_nothing_are_read(text: str, value: object) -> None:
    assert parse_change(f"a={text}") == {"a": value}


def test_a_case_id_of_digits_is_a_case_id() -> None:
    assert StudySettings.model_validate({"data": DATA, "template": 7}).template == "7"


@given(st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"]), max_size=12))
@settings(max_examples=200, deadline=None)
def test_any_case_id_survives_the_run_folders_study_yaml(name: str) -> None:
    text = StudySettings.model_validate({"data": DATA, "template": name}).to_yaml()
    assert yaml.load(text, Loader=SettingsLoader)["template"] == name


def test_numbers_survive_study_yaml() -> None:
    made = StudySettings.model_validate({"data": DATA, "training": {"learning_rate": 1e-7}})
    back = yaml.load(made.to_yaml(), Loader=SettingsLoader)
    assert StudySettings.model_validate(back) == made


def test_a_key_given_twice_is_refused_and_its_line_named(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("data:\n  source: masks\ntraining:\n  steps: 5\n  faces: 900\n  steps: 7\n")
    with pytest.raises(StudyError, match=r"the key steps is given twice(?s:.)*line 6"):
        read_yaml(path)
    with pytest.raises(StudyError, match=r"--set training\.steps is given twice"):
        parse_changes(["training.steps=5", "seed=1", "training.steps=7"])


def test_a_hundred_thousand_brackets_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("[" * 100_000)
    with pytest.raises(StudyError, match="can't be read as YAML"):
        read_yaml(tmp_path / "a.yaml")


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ("seed=-1", "seed"),
        ("seed=99999999999", "seed"),
        ("training.learning_rate=.inf", "learning_rate"),
        ("training.learning_rate=.nan", "learning_rate"),
        ("spectral.eigenpairs=600", r"surfaces of \d+ triangles .* allow at most"),
        ("training.faces=300", "Set fewer eigenpairs"),
    ],
)
def test_numbers_out_of_bounds_are_refused_before_any_work(change: str, what: str) -> None:
    with pytest.raises(StudyError, match=what):
        read_study("luna16", data=Path("masks"), changes=[change])


def test_a_section_that_is_set_to_a_value_is_refused() -> None:
    with pytest.raises(StudyError, match="a section `data` is needed"):
        read_study("luna16", changes=["data=5"])


def test_a_study_without_any_of_it_is_in_order() -> None:
    assert checked_as(StudySettings, {"data": DATA}, Path("a.yaml")).seed == 0

"""What remains of a withdrawn case in the settings, and what `status` reports afterwards."""

from __future__ import annotations

from pathlib import Path

import yaml

from ssm_pipeline.commands.forget_case import _forget_in_settings
from ssm_pipeline.commands.run_status import status_lines
from ssm_pipeline.engine.run_log import EVENT_LOG


def test_the_reason_of_another_case_loses_the_name(tmp_path: Path) -> None:
    path = tmp_path / "study.yaml"
    data = {"cases": ["a-1", "a-12"], "exclude": {"b": "a copy of a-1", "c": "unlike a-12"}}
    path.write_text(yaml.safe_dump({"data": data}))
    _forget_in_settings(path, "a-1")
    left = yaml.safe_load(path.read_text())["data"]
    assert left["exclude"] == {"b": "a copy of a withdrawn case", "c": "unlike a-12"}
    assert left["cases"] == ["a-12"]


def test_status_without_a_finished_stage_says_what_to_do(tmp_path: Path) -> None:
    event = '{"time": "2026-01-01T00:00:00+00:00", "event": "run finished"}\n'
    (tmp_path / EVENT_LOG).write_text(event)
    assert status_lines(tmp_path) == ["no stage is finished. Run the study again: workflow run"]

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any, cast

import pandas as pd
import pytest

from ssm_pipeline import storage
from ssm_pipeline.engine.left_files import CASE_FILE
from ssm_pipeline.engine.stage import StageRecord
from ssm_pipeline.records import Mesh
from ssm_pipeline.report.page_tables import page_tables
from ssm_pipeline.stages.report import _seconds


def test_tables_without_a_needed_column_are_refused(content: Any) -> None:
    with pytest.raises(ValueError, match=r"table correspondence lacks column.s. hd95_mm"):
        dataclasses.replace(content, correspondence=content.correspondence.drop(columns="hd95_mm"))
    with pytest.raises(ValueError, match=r"table specificity lacks column.s. chamfer_mm"):
        dataclasses.replace(content, metrics={"specificity": pd.DataFrame({"modes": [1]})})


def test_parts_of_different_studies_are_refused(content: Any) -> None:
    strange = Mesh(content.meshes[0].vertices, content.meshes[0].faces, "someone else")
    with pytest.raises(ValueError, match="someone else"):
        dataclasses.replace(content, meshes=(strange,))
    with pytest.raises(ValueError, match="2 frames for 8"):
        dataclasses.replace(content, frames=content.frames[:2])


def test_a_template_outside_the_cohort_shows_the_mean(content: Any) -> None:
    aligned = dataclasses.replace(content.aligned, template_id="atlas")
    with pytest.raises(ValueError, match="landmarks lie on template atlas"):
        dataclasses.replace(content, aligned=aligned)
    free = dataclasses.replace(content, aligned=aligned, landmarks=None)
    assert free.template_vertices is free.model.mean


def test_a_stage_that_was_reused_has_no_time(content: Any) -> None:
    stages = ({"name": "meshing", "seconds": None}, {"name": "spectral", "seconds": 1.5})
    table = page_tables(dataclasses.replace(content, stages=stages), 2).stages
    assert table is not None
    assert [row[1].text for row in table.rows] == ["reused", "1.50"]
    assert [row[1].values for row in table.rows] == [("",), ("1.5",)]


@pytest.mark.parametrize(("seconds", "expected"), [(0.02, None), (3.0, 3.0), (0.09, None)])
def test_a_stage_is_reused_if_its_cases_took_longer_than_it(
    tmp_path: Any, seconds: float, expected: Any
) -> None:
    record = cast(StageRecord, SimpleNamespace(seconds=seconds))
    for number in range(3):
        storage.write_json(tmp_path / f"case_{number}" / CASE_FILE, {"seconds": 1.0})
    assert _seconds(record, tmp_path) == expected


def test_a_quick_stage_keeps_its_time(tmp_path: Any) -> None:
    assert _seconds(cast(StageRecord, SimpleNamespace(seconds=0.02)), tmp_path) == 0.02

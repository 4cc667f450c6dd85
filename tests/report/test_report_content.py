from __future__ import annotations

import dataclasses

import pandas as pd
import pytest

from ssm_pipeline.records import Mesh


def test_tables_without_a_needed_column_are_refused(content) -> None:
    with pytest.raises(ValueError, match=r"table correspondence lacks column.s. hd95_mm"):
        dataclasses.replace(content, correspondence=content.correspondence.drop(columns="hd95_mm"))
    with pytest.raises(ValueError, match=r"table specificity lacks column.s. chamfer_mm"):
        dataclasses.replace(content, metrics={"specificity": pd.DataFrame({"modes": [1]})})


def test_parts_of_different_studies_are_refused(content) -> None:
    strange = Mesh(content.meshes[0].vertices, content.meshes[0].faces, "someone else")
    with pytest.raises(ValueError, match="someone else"):
        dataclasses.replace(content, meshes=(strange,))
    with pytest.raises(ValueError, match="2 frames for 8"):
        dataclasses.replace(content, frames=content.frames[:2])


def test_a_template_outside_the_cohort_shows_the_mean(content) -> None:
    aligned = dataclasses.replace(content.aligned, template_id="atlas")
    with pytest.raises(ValueError, match="landmarks lie on template atlas"):
        dataclasses.replace(content, aligned=aligned)
    free = dataclasses.replace(content, aligned=aligned, landmarks=None)
    assert free.template_vertices is free.model.mean

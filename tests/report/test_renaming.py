"""A page under pseudonyms: no former id is left, and every number stays with its case."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pandas as pd
import pytest
from synthetic_report import make_content

from ssm_pipeline.report.page import page_html
from ssm_pipeline.report.renaming import renamed
from ssm_pipeline.report.settings import ReportSettings


@pytest.fixture(scope="module")
def original():
    content = make_content(120, 6)
    ids = content.aligned.case_ids
    check = pd.DataFrame(
        {"case_id": ids, "volume_z": np.arange(6.0), "remarks": [f"like {ids[3]}", *[""] * 5]}
    )
    return dataclasses.replace(
        content,
        check=check,
        check_pictures={ids[0]: b"png"},
        settings={"data": {"exclude": {ids[1]: f"a copy of {ids[2]}"}, "only": [ids[4]]}},
    )


@pytest.fixture(scope="module")
def names(original: Any) -> dict[str, str]:
    """In another order than the run's."""
    ids = sorted(original.names)
    return {case_id: f"case_{(3 * n + 2) % len(ids):03d}" for n, case_id in enumerate(ids)}


def test_no_former_id_is_left_on_the_page(original: Any, names: dict[str, str]) -> None:
    assert len(set(names.values())) == len(names) == 7
    settings = ReportSettings(modes=2, tile_px=64, case_faces=200)
    assert "blob.003" in page_html(original, settings)
    page = page_html(renamed(original, names), settings)
    assert "blob." not in page
    assert names["blob.003"] in page


def test_numbers_stay_with_their_case(original: Any, names: dict[str, str]) -> None:
    new = renamed(original, names)
    assert list(new.model.case_ids) == sorted(new.model.case_ids)
    assert new.model.case_ids != tuple(names[c] for c in original.model.case_ids)
    for index, case_id in enumerate(original.model.case_ids):
        at = new.model.case_ids.index(names[case_id])
        np.testing.assert_array_equal(new.model.scores[at], original.model.scores[index])
        np.testing.assert_array_equal(new.aligned.vertices[at], original.aligned.vertices[index])
        assert new.frames[at] is original.frames[index]
        own, former = new.mesh_of(names[case_id]), original.mesh_of(case_id)
        np.testing.assert_array_equal(own.vertices, former.vertices)
        for table in ("correspondence", "cohort"):
            rows = [getattr(c, table).set_index("case_id") for c in (new, original)]
            numbers = [
                r.loc[n].dropna() for r, n in zip(rows, (names[case_id], case_id), strict=True)
            ]
            kept = [r[[isinstance(v, float) for v in r]] for r in numbers]
            assert kept[0].to_dict() == kept[1].to_dict()
    assert list(new.cohort["case_id"]) == sorted(new.cohort["case_id"])


def test_every_id_needs_a_new_one(original: Any, names: dict[str, str]) -> None:
    with pytest.raises(ValueError, match=r"no new id for blob\.bad"):
        renamed(original, {k: v for k, v in names.items() if k != "blob.bad"})

"""A page under pseudonyms: no former id is left, and every number stays with its case."""

from __future__ import annotations

import dataclasses
import html
from contextlib import nullcontext
from typing import Any

import numpy as np
import pandas as pd
import pytest
from synthetic_report import make_content

from ssm_pipeline.cohort_check.copies import SAME, copies_table
from ssm_pipeline.report.content import ReportContent
from ssm_pipeline.report.ids_left import refuse_ids_left
from ssm_pipeline.report.page import page_html
from ssm_pipeline.report.renaming import renamed, renamed_html
from ssm_pipeline.report.settings import ReportSettings


@pytest.fixture(scope="module")
def original() -> ReportContent:
    content: ReportContent = make_content(120, 6)
    ids = content.aligned.case_ids
    check = pd.DataFrame(
        {"case_id": ids, "volume_z": np.arange(6.0), "remarks": [f"like {ids[3]}", *[""] * 5]}
    )
    return dataclasses.replace(
        content,
        check=check,
        check_pictures={ids[0]: b"png"},
        copies=copies_table([(ids[0], ids[2], SAME), (ids[1], ids[2], SAME)]),
        patients_advice=f"1 patient seems to have several cases ({ids[1]} and {ids[4]})",
        settings={"data": {"exclude": {ids[1]: f"a copy of {ids[2]}"}, "only": [ids[4]]}},
    )


@pytest.fixture(scope="module")
def names(original: Any) -> dict[str, str]:
    """In another order than the run's."""
    ids = sorted(original.names)
    return {case_id: f"case_{(3 * n + 2) % len(ids):03d}" for n, case_id in enumerate(ids)}


SETTINGS = ReportSettings(modes=2, tile_px=64, case_faces=200)


def test_no_former_id_is_left_on_the_page(original: Any, names: dict[str, str]) -> None:
    assert len(set(names.values())) == len(names) == 7
    assert "blob.003" in page_html(original, SETTINGS)
    page = renamed_html(original, names, SETTINGS)
    assert "blob." not in page
    assert "~0000" not in page
    first, second, third, fifth = (names[original.aligned.case_ids[n]] for n in (0, 1, 2, 4))
    text = html.unescape(page)
    assert f'"{third}": "copy of {first}"' in text
    assert f"several cases ({second} and {fifth})" in text


def test_new_ids_may_be_the_former_ids_of_other_cases(original: Any) -> None:
    ids = sorted(original.names)
    names = dict(zip(ids, [*ids[1:], ids[0]], strict=True))
    text = html.unescape(renamed_html(original, names, SETTINGS))
    first, third = (names[original.aligned.case_ids[n]] for n in (0, 2))
    assert f'"{third}": "copy of {first}"' in text


def test_a_page_that_would_show_a_former_id_is_refused(
    original: Any, names: dict[str, str]
) -> None:
    named_after_a_case = dataclasses.replace(original, study="my_BLOB.003_study")
    with pytest.raises(ValueError, match=r"still show 1 of 7 case ids, such as blob\.003"):
        renamed_html(named_after_a_case, names, SETTINGS)


@pytest.mark.parametrize(
    ("page", "is_refused"),
    [
        ("<p>case &quot;p1&quot;</p>", True),
        ("<p>p10 of 12 cases, the mean</p>", False),
        ("<td title='12'>…</td>", True),
        ('<script type="application/json">{"cases": ["mean"], "n": 12}</script>', True),
        ('<script type="application/json">{"label": "mean", "n": 12}</script>', False),
        ('<script type="application/json">{"label": "M\\u00fcller_7"}</script>', True),
        ("<img src='data:image/png;base64,p1+12'><style>p1</style><script>p1</script>", False),
    ],
)
def test_what_counts_as_a_former_id(page: str, is_refused: bool) -> None:
    """Ids that are words or numbers of the page itself are searched only where ids stand."""
    with pytest.raises(ValueError, match="such as") if is_refused else nullcontext():
        refuse_ids_left(page, ["p1", "12", "mean", "Müller_7"])


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
        assert own is not None
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

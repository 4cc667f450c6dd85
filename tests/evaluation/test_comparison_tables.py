"""The tables of all methods together."""

from __future__ import annotations

import pandas as pd
import pytest

from ssm_pipeline.evaluation import tables as module
from ssm_pipeline.evaluation.paired import PairedDifference


def test_p_values_of_unseen_cases_are_corrected_for_the_number_of_methods(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Holm by hand: the smaller p counts twice, and the other is at least as large."""
    raw = iter([0.03, 0.04])
    monkeypatch.setattr(
        module, "over_cases", lambda *_: PairedDifference(value=1.0, low=0.5, high=1.5, p=next(raw))
    )
    names = ["full", "network start", "S3M"]
    cases = pd.DataFrame({"method": names, "modes": 2, "case_id": "a", "surface_mm": [1.0, 2, 2]})
    drawn = pd.DataFrame({"method": names, "surface_mm": 3.0, "seen_surface_mm": 2.0})
    unseen = {"unseen_generalisation": cases, "unseen_specificity": drawn}
    tables = {"generalisation": cases, "comparison": pd.DataFrame({"method": names})}
    found = module.with_unseen(tables, unseen, 10, 0)["comparison"].set_index("method")
    p = found["unseen_generalisation_surface_p"]
    assert p[["network start", "S3M"]].tolist() == pytest.approx([0.06, 0.06])
    assert pd.isna(p["full"])

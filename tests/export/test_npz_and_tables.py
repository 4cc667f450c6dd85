"""Arrays and tables say everything that the model does, to plain NumPy and pandas."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from posed_spheres import Spheres

from ssm_pipeline.export.tables import write_tables


def test_npz_rebuilds_every_case(spheres: Spheres, tmp_path: Path) -> None:
    spheres.model.save(tmp_path / "model.npz")
    with np.load(tmp_path / "model.npz") as file:  # allow_pickle is off by default
        weights = file["scores"] * np.sqrt(file["variances"])
        shapes = file["mean"] + np.tensordot(weights, file["modes"], axes=1)
        assert tuple(file["case_ids"]) == spheres.shapes.case_ids
        assert (str(file["unit"]), str(file["space"])) == ("mm", "LPS")
        assert int(file["format_version"]) == 1
        np.testing.assert_array_equal(file["faces"], spheres.shapes.faces)
    # All modes are kept, so that each case is its own reconstruction, to round-off.
    np.testing.assert_allclose(shapes, spheres.aligned.vertices, atol=1e-9)


def test_tables_hold_scores_in_deviations_and_variances(spheres: Spheres, tmp_path: Path) -> None:
    written = write_tables(spheres.model, tmp_path)
    assert [path.name for path in written] == ["scores.csv", "modes.csv"]
    scores = pd.read_csv(written[0], dtype={"case_id": str}, keep_default_na=False)
    assert tuple(scores.pop("case_id")) == spheres.shapes.case_ids
    assert list(scores.columns) == [f"mode_{m}_sd" for m in range(1, len(scores.columns) + 1)]
    # Standard deviations with divisor N − 1: each column's own is 1, and its mean 0.
    np.testing.assert_allclose(scores.std(ddof=1), 1, rtol=1e-9)
    np.testing.assert_allclose(scores.mean(), 0, atol=1e-9)
    modes = pd.read_csv(written[1])
    flat = spheres.aligned.vertices.reshape(6, -1)
    assert modes["variance_mm2"].sum() == pytest.approx(flat.var(axis=0, ddof=1).sum())
    np.testing.assert_allclose(modes["share"].cumsum(), modes["cumulative_share"])
    assert modes["cumulative_share"].iloc[-1] == pytest.approx(1)
    assert list(modes["mode"]) == list(range(1, len(scores.columns) + 1))

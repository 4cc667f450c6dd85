"""Models in other units: read in the unit that is given, refused with a guess without one."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from ssm_pipeline.commands.import_model import import_model
from ssm_pipeline.records import StudyError
from ssm_pipeline.runs.run import load_run
from ssm_pipeline.shape_model.model import ShapeModel


def saved(path: Path, scale: float) -> ShapeModel:
    """A tetrahedron of 40 mm, written in another unit; the model in millimetres is returned."""
    modes = np.linalg.qr(np.random.default_rng(0).standard_normal((12, 2)))[0].T
    model = ShapeModel(
        mean=np.vstack([np.zeros(3), 40 * np.eye(3)]),
        modes=modes.reshape(2, 4, 3),
        variances=np.array([9.0, 4.0]),
        faces=np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
        scores=np.array([[1.0, 0.5], [-1.0, -0.5]]),
        case_ids=("a", "b"),
    )
    dataclasses.replace(model, mean=scale * model.mean, variances=scale**2 * model.variances).save(
        path
    )
    return model


def test_a_model_in_micrometres_is_refused_unless_its_unit_is_given(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    model = saved(path, 1000.0)
    with pytest.raises(StudyError, match=r"is 6\.93e\+04 across.*pass --unit um"):
        import_model(path, None, tmp_path / "runs", (1,))
    run = load_run(import_model(path, None, tmp_path / "runs", (1,), "um"))
    np.testing.assert_allclose(run.model.mean, model.mean)
    np.testing.assert_allclose(run.model.variances, model.variances)
    np.testing.assert_allclose(run.model.reconstruct([2.0, 1.0]), model.reconstruct([2.0, 1.0]))


def test_a_mean_without_extent_is_refused(tmp_path: Path) -> None:
    saved(tmp_path / "a.npz", 0.0)
    with pytest.raises(StudyError, match="all points of the mean shape coincide"):
        import_model(tmp_path / "a.npz", None, tmp_path / "runs", (1,), "m")

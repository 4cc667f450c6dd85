"""Statismo files written by hand, to Scalismo's layout, whole and broken."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from ssm_pipeline.export.statismo_reading import read_statismo
from ssm_pipeline.records import StudyError

MEAN = np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 10]], dtype=np.float32)
CELLS = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.int32)
BASIS = np.linalg.qr(np.random.default_rng(0).standard_normal((12, 2)))[0].astype(np.float32)


def written(path: Path, **changes: object) -> Path:
    """A file as Scalismo writes it: no scores, no cases. `changes`: dataset → another content, or
    None to leave it out."""
    content: dict[str, object] = {
        "version/majorVersion": np.int32(0),
        "version/minorVersion": np.int32(9),
        "representer/points": MEAN.T,
        "representer/cells": CELLS.T,
        "model/mean": MEAN.ravel(),
        "model/pcaBasis": BASIS,
        "model/pcaVariance": np.array([9.0, 4.0], np.float32),
        "model/noiseVariance": np.float32(0),
    }
    content |= {name.replace("__", "/"): value for name, value in changes.items()}
    with h5py.File(path, "w") as file:
        for name, value in content.items():
            if value is not None:
                file[name] = value
        file.require_group("representer").attrs["name"] = np.bytes_("vtkStandardMeshRepresenter")
    return path


def test_a_file_written_by_hand_is_read(tmp_path: Path):
    model = read_statismo(written(tmp_path / "hand.h5"))
    np.testing.assert_allclose(model.mean, MEAN)
    np.testing.assert_array_equal(model.faces, CELLS)
    np.testing.assert_allclose(model.variances, [9, 4])
    shape = MEAN.ravel() + BASIS @ [2 * 3.0, -1 * 2.0]
    np.testing.assert_allclose(model.reconstruct([2.0, -1.0]).ravel(), shape, atol=1e-5)
    assert model.case_ids == ()


def test_a_basis_that_is_not_orthonormal_keeps_its_covariance(tmp_path: Path):
    skew = (BASIS @ [[2.0, 1.0], [0.0, 1.5]]).astype(np.float32)
    model = read_statismo(written(tmp_path / "skew.h5", model__pcaBasis=skew))
    flat = model.modes.reshape(2, -1)
    np.testing.assert_allclose(flat @ flat.T, np.eye(2), atol=1e-6)
    expected = skew @ np.diag([9.0, 4.0]) @ skew.T
    np.testing.assert_allclose(flat.T * model.variances @ flat, expected, atol=1e-4)


def test_scores_and_cases_are_read_where_they_are(tmp_path: Path):
    changes = {
        "modelinfo__scores": np.array([[1.0, -1.0], [0.5, -0.5]], np.float32),
        "modelinfo__modelBuilder-0__dataInfo__URI_0": np.bytes_("a"),
        "modelinfo__modelBuilder-0__dataInfo__URI_1": np.bytes_("b"),
    }
    model = read_statismo(written(tmp_path / "cases.h5", **changes))
    assert model.case_ids == ("a", "b")
    np.testing.assert_allclose(model.scores, [[1, 0.5], [-1, -0.5]])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"model__mean": None}, "has no model/mean"),
        ({"model__mean": np.zeros(9, np.float32)}, "9 numbers for 4 points"),
        ({"model__pcaBasis": BASIS.T}, r"basis has shape \(2, 12\)"),
        ({"model__pcaVariance": np.array([9.0, np.nan], np.float32)}, "not finite"),
        ({"model__pcaVariance": np.zeros(2, np.float32)}, "all variances are 0"),
        ({"representer__cells": CELLS.T + 2}, "no triangles of its 4 points"),
        ({"model__mean": "text"}, "model/mean"),
    ],
)
def test_a_broken_file_says_what_is_wrong(tmp_path: Path, changes, message):
    with pytest.raises(StudyError, match=message):
        read_statismo(written(tmp_path / "broken.h5", **changes))


def test_what_is_no_hdf5_is_said(tmp_path: Path):
    path = tmp_path / "model.h5"
    path.write_bytes(b"not a model")
    with pytest.raises(StudyError, match="no HDF5 file, or is damaged"):
        read_statismo(path)
    with pytest.raises(StudyError, match="there is no file"):
        read_statismo(tmp_path / "absent.h5")

"""Statismo files written by hand, to Scalismo's layout, whole and broken."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hdf5_json_files import as_json

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


def test_a_file_written_by_hand_is_read(tmp_path: Path) -> None:
    model = read_statismo(written(tmp_path / "hand.h5"))
    np.testing.assert_allclose(model.mean, MEAN)
    np.testing.assert_array_equal(model.faces, CELLS)
    np.testing.assert_allclose(model.variances, [9, 4])
    shape: np.ndarray = MEAN.ravel() + BASIS @ [2 * 3.0, -1 * 2.0]
    np.testing.assert_allclose(model.reconstruct([2.0, -1.0]).ravel(), shape, atol=1e-5)
    assert model.case_ids == ()


def test_a_basis_whose_columns_are_not_orthogonal_keeps_its_covariance(tmp_path: Path) -> None:
    skew = BASIS @ [[1.0, 0.6], [0.0, 0.8]]  # columns of length 1
    model = read_statismo(written(tmp_path / "skew.h5", model__pcaBasis=skew.astype(np.float32)))
    flat = model.modes.reshape(2, -1)
    np.testing.assert_allclose(flat @ flat.T, np.eye(2), atol=1e-6)
    expected = skew @ np.diag([9.0, 4.0]) @ skew.T
    np.testing.assert_allclose(flat.T * model.variances @ flat, expected, atol=1e-4)


NO_VERSION: dict[str, object] = {"version__majorVersion": None, "version__minorVersion": None}
SCALED = (BASIS * [3.0, 2.0]).astype(np.float32)  # by standard deviations, as version 0.8 does


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"version__minorVersion": np.int32(8), "model__pcaBasis": SCALED},
        {"version__majorVersion": np.int32(1), "version__minorVersion": np.int32(0)},
        NO_VERSION,
        {**NO_VERSION, "model__pcaBasis": SCALED},
    ],
)
def test_version_and_lengths_of_the_basis_tell_the_variances(tmp_path: Path, changes: Any) -> None:
    model = read_statismo(written(tmp_path / "a.h5", **changes))
    np.testing.assert_allclose(model.variances, [9, 4], rtol=1e-6)
    np.testing.assert_allclose(model.modes.reshape(2, -1).T, BASIS, atol=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"model__pcaBasis": SCALED}, r"version 0\.9 .* lengths of 2 to 3\. In .*\(2 to 3\)"),
        ({"version__minorVersion": np.int32(8)}, r"version 0\.8 .* lengths of 1 to 1"),
        ({**NO_VERSION, "model__pcaBasis": 2 * SCALED}, "states no version"),
    ],
)
def test_version_and_lengths_that_contradict_each_other_are_refused(
    tmp_path: Path, changes: Any, message: str
) -> None:
    with pytest.raises(StudyError, match=message):
        read_statismo(written(tmp_path / "a.h5", **changes))


def test_a_version_is_known_by_the_representer_of_its_time(tmp_path: Path) -> None:
    path = written(tmp_path / "a.h5", **NO_VERSION)
    with h5py.File(path, "a") as file:
        file["representer"].attrs["name"] = np.bytes_("vtkPolyDataRepresenter")
    with pytest.raises(StudyError, match=r"version 0\.8 .* lengths of 1 to 1"):
        read_statismo(path)


def in_groups(path: Path, *names: str, kind: str = "POLYGON_MESH") -> Path:
    """The model of `written` in groups of one file, as a catalogue has them."""
    with h5py.File(written(path.with_suffix(".one")), "r") as one, h5py.File(path, "w") as file:
        one.copy("version", file)
        for name in names:
            one.copy("model", file.require_group(name))
            one.copy("representer", file[name])
            file[name]["representer"].attrs["datasetType"] = np.bytes_(kind)
            kind = "POLYGON_MESH_DATA"  # of all but the first
    return path


def test_a_model_in_a_group_is_found(tmp_path: Path) -> None:
    path = in_groups(tmp_path / "a.h5", "models/shape", "models/colour")
    np.testing.assert_allclose(read_statismo(path).variances, [9, 4])
    path = in_groups(tmp_path / "b.h5", "a", "b")
    with h5py.File(path, "a") as file:
        file["b/representer"].attrs["datasetType"] = np.bytes_("POLYGON_MESH")
    with pytest.raises(StudyError, match="holds 2 models: /a, /b"):
        read_statismo(path)


def test_the_json_of_a_file_gives_the_same_model(tmp_path: Path) -> None:
    scores = {"modelinfo__scores": np.array([[1.0, -1.0], [0.5, -0.5]], np.float32)}
    path = written(tmp_path / "a.h5", **scores)
    model, other = read_statismo(path), read_statismo(as_json(path))
    for name in ("mean", "modes", "variances", "faces", "scores"):
        np.testing.assert_array_equal(getattr(model, name), getattr(other, name))
    old = written(tmp_path / "old.h5", **NO_VERSION, model__pcaBasis=SCALED)
    np.testing.assert_allclose(read_statismo(as_json(old)).variances, [9, 4], rtol=1e-6)


def test_json_that_is_no_tree_is_refused(tmp_path: Path) -> None:
    endless = {
        "root": "a",
        "groups": {"a": {"links": [{"title": "x", "collection": "groups", "id": "a"}]}},
        "datasets": {},
    }
    for content in (json.dumps(endless), "{", "{}", '{"root": 1, "groups": []}'):
        (tmp_path / "a.h5.json").write_text(content)
        with pytest.raises(StudyError, match="no HDF5 content as JSON"):
            read_statismo(tmp_path / "a.h5.json")


def test_scores_and_cases_are_read_where_they_are(tmp_path: Path) -> None:
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
def test_a_broken_file_says_what_is_wrong(tmp_path: Path, changes: Any, message: str) -> None:
    with pytest.raises(StudyError, match=message):
        read_statismo(written(tmp_path / "broken.h5", **changes))


def test_what_is_no_hdf5_is_said(tmp_path: Path) -> None:
    path = tmp_path / "model.h5"
    path.write_bytes(b"not a model")
    with pytest.raises(StudyError, match="no HDF5 file, or is damaged"):
        read_statismo(path)
    with pytest.raises(StudyError, match="there is no file"):
        read_statismo(tmp_path / "absent.h5")

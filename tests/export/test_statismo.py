"""The Statismo file, read by h5py the way Scalismo reads it."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from posed_spheres import Spheres

from ssm_pipeline.export.statismo import write_statismo


@pytest.fixture(scope="module")
def path(spheres: Spheres, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("statismo") / "model.h5"
    write_statismo(spheres.model, path, "2024-05-01T12:00:00+00:00")
    return path


def test_mean_and_basis_reproduce_an_instance(spheres: Spheres, path: Path) -> None:
    scores = np.array([1.5, -0.5, 2.0])
    with h5py.File(path) as file:
        basis, variance = file["model/pcaBasis"][()], file["model/pcaVariance"][()]
        instance = file["model/mean"][()] + basis[:, :3] @ (scores * np.sqrt(variance[:3]))
        reference, cells = file["representer/points"][()], file["representer/cells"][()]
        stored_scores = file["modelinfo/scores"][()]
    expected = spheres.model.reconstruct(scores)
    # float32 at 60 mm, summed over four terms.
    np.testing.assert_allclose(instance.reshape(-1, 3), expected, atol=1e-4)
    np.testing.assert_allclose(basis.T @ basis, np.eye(basis.shape[1]), atol=1e-5)
    np.testing.assert_allclose(reference.T, spheres.model.mean, atol=1e-5)
    np.testing.assert_array_equal(cells.T, spheres.model.faces)
    np.testing.assert_allclose(stored_scores.T, spheres.model.scores, atol=1e-5)


def test_only_the_number_types_and_strings_that_scalismo_takes(path: Path) -> None:
    seen = set()

    def look(name: str, node: h5py.Group | h5py.Dataset) -> None:
        dtypes = [value.dtype for value in [node] if isinstance(value, h5py.Dataset)]
        dtypes += [node.attrs.get_id(key).dtype for key in node.attrs]
        for dtype in dtypes:
            assert h5py.check_string_dtype(dtype) is None or dtype.kind == "S", name
            seen.add(dtype.kind if dtype.kind == "S" else str(dtype))

    with h5py.File(path) as file:
        file.visititems(look)
        assert (file["version/majorVersion"][()], file["version/minorVersion"][()]) == (0, 9)
        assert file["representer"].attrs["name"] == b"itkStandardMeshRepresenter"
        assert file["representer"].attrs["datasetType"] == b"POLYGON_MESH"
        assert file["model/mean"].ndim == file["model/pcaVariance"].ndim == 1
    assert seen == {"float32", "int32", "S"}


def test_cases_space_and_unit_are_named(spheres: Spheres, path: Path) -> None:
    with h5py.File(path) as file:
        builder = file["modelinfo/modelBuilder-0"]
        named = [builder[f"dataInfo/URI_{n}"][()].decode() for n in range(6)]
        assert tuple(named) == spheres.shapes.case_ids
        assert builder["parameters/space"][()] == b"LPS"
        assert builder["parameters/unit"][()] == b"mm"
        assert file["modelinfo/build-time"][()] == b"2024-05-01T12:00:00+00:00"

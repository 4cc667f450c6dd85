"""One file format for a model, whoever writes it; damage and strangers are named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ssm_pipeline import storage
from ssm_pipeline.records import DamagedFile, Mesh
from ssm_pipeline.shape_model.model import ShapeModel, load_model


def model() -> ShapeModel:
    generator = np.random.default_rng(0)
    modes, _ = np.linalg.qr(generator.standard_normal((12, 3)))
    return ShapeModel(
        mean=generator.standard_normal((4, 3)),
        modes=modes.T.reshape(3, 4, 3),
        variances=np.array([9.0, 4, 1]),
        faces=np.array([[0, 1, 2], [1, 2, 3]]),
        scores=generator.standard_normal((4, 3)),
        case_ids=("007", "é.1", "c", "d"),
    )


def test_a_model_is_read_back_to_the_same_bits(tmp_path: Path) -> None:
    model().save(tmp_path / "liver.npz")
    read = load_model(str(tmp_path / "liver.npz"))
    for name in ("mean", "modes", "variances", "faces", "scores"):
        np.testing.assert_array_equal(getattr(read, name), getattr(model(), name))
    assert read.case_ids == ("007", "é.1", "c", "d")


def test_a_model_of_no_cohort_is_read_back(tmp_path: Path) -> None:
    posterior = model().posterior(np.array([0]), np.zeros((1, 3)), noise_mm=1.0)
    posterior.save(tmp_path / "open.npz")
    assert load_model(tmp_path / "open.npz").case_ids == ()


def test_a_model_cut_off_anywhere_is_refused(tmp_path: Path) -> None:
    model().save(tmp_path / "whole.npz")
    content = (tmp_path / "whole.npz").read_bytes()
    for share in (0, 0.3, 0.9, 0.999):
        (tmp_path / "cut.npz").write_bytes(content[: int(share * len(content))])
        with pytest.raises(DamagedFile, match=r"cut\.npz"):
            load_model(tmp_path / "cut.npz")


def test_other_files_other_units_and_versions_are_named(tmp_path: Path) -> None:
    storage.save(Mesh(np.eye(3), np.array([[0, 1, 2]]), "a"), tmp_path / "mesh.npz")
    with pytest.raises(DamagedFile, match="no shape model: it holds no mean"):
        load_model(tmp_path / "mesh.npz")
    with pytest.raises(DamagedFile, match="is missing"):
        load_model(tmp_path / "none.npz")
    model().save(tmp_path / "model.npz")
    arrays = storage.load_arrays(tmp_path / "model.npz")
    for name, other in (("unit", "m"), ("space", "RAS"), ("format_version", 2)):
        storage.save_arrays(arrays | {name: np.array(other)}, tmp_path / "other.npz")
        with pytest.raises(DamagedFile, match=f"of {name} {other}; "):
            load_model(tmp_path / "other.npz")
    storage.save_arrays(arrays | {"modes": arrays["modes"][:, :2]}, tmp_path / "other.npz")
    with pytest.raises(DamagedFile, match="modes have shape"):
        load_model(tmp_path / "other.npz")

"""Statismo's HDF5 file (.h5), ours or another program's, read as a ShapeModel."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from ssm_pipeline.records import StudyError
from ssm_pipeline.shape_model.model import ShapeModel

# Principal components are written in single precision: 1e-7 a number, 3V of them.
ORTHONORMAL = 1e-3


def read_statismo(path: Path) -> ShapeModel:
    """The model of a Statismo or Scalismo file, in the millimetres it was written in.

    Its scores and cases are read where it has them; without, both are empty. A basis that is not
    orthonormal, as Statismo before 0.9 wrote it, is made so.
    Raises StudyError, naming what is missing or does not fit, for anything that is no model.
    Source: scalismo.io.StatismoIO.
    """
    if not path.is_file():
        raise StudyError(f"there is no file {path}.")
    try:
        with h5py.File(path, "r") as file:
            return _model_in(file, path)
    except (OSError, RuntimeError, KeyError) as error:  # h5py, by where the damage is
        raise StudyError(f"{path} is no HDF5 file, or is damaged: {error}.") from error


def _model_in(file: h5py.File, path: Path) -> ShapeModel:
    points = _array(file, path, "representer/points", 2)
    faces = _array(file, path, "representer/cells", 2)
    mean = _array(file, path, "model/mean", 1)
    basis = _array(file, path, "model/pcaBasis", 2)
    variances = _array(file, path, "model/pcaVariance", 1)
    points = points.T if points.shape[0] == 3 else points
    faces = (faces.T if faces.shape[0] == 3 else faces).astype(np.int64)
    count = len(points)
    if points.shape[1] != 3 or len(mean) != 3 * count:
        raise StudyError(
            f"{path}: the mean has {len(mean)} numbers for {count} points of the reference; three "
            "a point are needed. Only models of triangle meshes in 3D are read."
        )
    if basis.shape != (3 * count, len(variances)):
        raise StudyError(
            f"{path}: the basis has shape {basis.shape} for {3 * count} coordinates and "
            f"{len(variances)} variances; a row per coordinate, a column per variance is needed."
        )
    if faces.shape[1] != 3 or faces.min() < 0 or faces.max() >= count:
        raise StudyError(f"{path}: the reference's cells are no triangles of its {count} points.")
    numbers = (points, mean, basis, variances)
    if not all(np.isfinite(array).all() for array in numbers) or (variances < 0).any():
        raise StudyError(f"{path}: the model holds numbers that are not finite, or variances < 0.")
    if not (variances > 0).any():
        raise StudyError(f"{path}: all variances are 0; the model has no modes.")
    modes, variances = _orthonormal(basis, variances)
    scores, case_ids = _cases(file, len(variances), basis.shape[1])
    return ShapeModel(
        mean=mean.reshape(count, 3),
        modes=modes.reshape(-1, count, 3),
        variances=variances,
        faces=faces,
        scores=scores,
        case_ids=case_ids,
    )


def _array(file: h5py.File, path: Path, name: str, dimensions: int) -> np.ndarray:
    found = file.get(name)
    if not isinstance(found, h5py.Dataset):
        raise StudyError(
            f"{path} has no {name}, so it holds no shape model in Statismo's layout. Save it with "
            "Scalismo's StatismoIO, or from a program that writes this format."
        )
    try:
        array = np.asarray(found, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise StudyError(f"{path}: {name} holds no numbers.") from error
    if array.ndim != dimensions or array.size == 0:
        raise StudyError(
            f"{path}: {name} has shape {array.shape}; {dimensions} dimensions are needed, none of "
            "them empty."
        )
    return array


def _orthonormal(basis: np.ndarray, variances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """modes (K, 3V) of unit length, and their variances, descending; covariance kept."""
    kept = variances > variances.max() * 1e-12
    basis, variances = basis[:, kept], variances[kept]
    order = np.argsort(variances)[::-1]
    basis, variances = basis[:, order], variances[order]
    if np.abs(basis.T @ basis - np.eye(len(variances))).max() < ORTHONORMAL:
        return np.ascontiguousarray(basis.T), variances
    U, singular, _ = np.linalg.svd(basis * np.sqrt(variances), full_matrices=False)
    return np.ascontiguousarray(U.T), singular**2


def _cases(file: h5py.File, modes: int, columns: int) -> tuple[np.ndarray, tuple[str, ...]]:
    """scores (N, M) and case ids, where the file's scores belong to the modes as read."""
    none = np.zeros((0, modes)), ()
    scores = file.get("modelinfo/scores")
    if not isinstance(scores, h5py.Dataset) or modes != columns:
        return none
    values = np.asarray(scores, dtype=np.float64)
    if values.ndim != 2 or values.shape[0] != modes or not np.isfinite(values).all():
        return none
    count = values.shape[1]
    info = file.get("modelinfo/modelBuilder-0/dataInfo")
    names = []
    for index in range(count):
        uri = info.get(f"URI_{index}") if isinstance(info, h5py.Group) else None
        text = uri[()] if isinstance(uri, h5py.Dataset) else f"case_{index + 1:03d}"
        names.append(text.decode(errors="replace") if isinstance(text, bytes) else str(text))
    if len(set(names)) < count:
        names = [f"case_{index + 1:03d}" for index in range(count)]
    return values.T, tuple(names)

"""Statismo's HDF5 file (.h5 or .h5.json), ours or another program's, read as a ShapeModel."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ssm_pipeline.export.hdf5_json import hdf5_of_json
from ssm_pipeline.records import StudyError
from ssm_pipeline.shape_model.model import ShapeModel

# Principal components are written in single precision: 1e-7 per number, 3V of them.
ORTHONORMAL = 1e-3
SCALED_REPRESENTERS = ("vtkPolyDataRepresenter", "itkMeshRepresenter")  # those of Statismo 0.8


def read_statismo(path: Path) -> ShapeModel:
    """The model of a Statismo or Scalismo file, in the unit it was written in.

    Its scores and cases are read if it has them; otherwise both are empty. In files of version 0.8
    the columns of the basis have the lengths of the standard deviations, since 0.9 the length 1;
    version and lengths must agree. A basis whose columns are not orthogonal is made so, and its
    covariance is kept. A model may be in a group of the file, as in catalogues.

    Raises:
        StudyError: the file is no model, contradicts itself, or holds several models.

    Source: scalismo.io.StatismoIO.
    """
    if not path.is_file():
        raise StudyError(f"there is no file {path}.")
    content = path.read_bytes()
    try:
        if content.lstrip()[:1] == b"{":
            return _model_in(hdf5_of_json(content, path), path)
        with h5py.File(io.BytesIO(content), "r") as file:
            return _model_in(file, path)
    # What h5py raises depends on where the damage is.
    except (OSError, RuntimeError, KeyError, OverflowError) as error:
        raise StudyError(f"{path} is no HDF5 file, or is damaged: {error}.") from error


def _model_in(file: h5py.File, path: Path) -> ShapeModel:
    group = _group_of_model(file, path)
    points = _array(group, path, "representer/points", 2)
    faces = _array(group, path, "representer/cells", 2)
    mean = _array(group, path, "model/mean", 1)
    basis = _array(group, path, "model/pcaBasis", 2)
    variances = _array(group, path, "model/pcaVariance", 1)
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
    basis = _unscaled(basis, variances, _version(file, group), path)
    modes, variances = _orthonormal(basis, variances)
    scores, case_ids = _cases(group, len(variances), basis.shape[1])
    return ShapeModel(
        mean=mean.reshape(count, 3),
        modes=modes.reshape(-1, count, 3),
        variances=variances,
        faces=faces,
        scores=scores,
        case_ids=case_ids,
    )


def _group_of_model(file: h5py.File, path: Path) -> h5py.Group:
    """The root, or the one group with a model of a triangle mesh."""
    if "model" in file or "representer" in file:
        return file
    found: list[h5py.Group] = []

    def collect(name: str, member: Any) -> None:
        if isinstance(member, h5py.Group) and "model/mean" in member and "representer" in member:
            kind = _text(member["representer"].attrs.get("datasetType", "POLYGON_MESH"))
            if kind == "POLYGON_MESH":
                found.append(member)

    file.visititems(collect)
    if len(found) > 1:
        raise StudyError(
            f"{path} holds {len(found)} models: {', '.join(str(g.name) for g in found)}. A file "
            "with one model is needed; save the one that is meant from Scalismo."
        )
    return found[0] if found else file  # without a model, its absence is reported by name


def _version(file: h5py.File, group: h5py.Group) -> tuple[int, int] | None:
    """The format's version; None where the file does not tell. Raises KeyError, OSError."""
    numbers = [file.get(f"version/{part}") for part in ("majorVersion", "minorVersion")]
    if all(isinstance(number, h5py.Dataset) and number.size == 1 for number in numbers):
        try:
            major, minor = (int(np.asarray(number).item()) for number in numbers)
        except (TypeError, ValueError):
            return None
        return major, minor
    representer = group.get("representer")
    name = _text(representer.attrs.get("name", "")) if isinstance(representer, h5py.Group) else ""
    return (0, 8) if name in SCALED_REPRESENTERS else None


def _text(value: Any) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def _unscaled(
    basis: np.ndarray, variances: np.ndarray, version: tuple[int, int] | None, path: Path
) -> np.ndarray:
    """The basis with columns of length 1.

    Raises:
        StudyError: Where lengths and version disagree.
    """
    kept = variances > variances.max() * 1e-12
    squares = (basis[:, kept] ** 2).sum(axis=0)
    is_unit = bool(np.abs(squares - 1).max() < ORTHONORMAL)
    is_scaled = bool(np.abs(squares / variances[kept] - 1).max() < ORTHONORMAL)
    stated = "no version" if version is None else f"version {version[0]}.{version[1]}"
    expected = is_unit or is_scaled if version is None else is_unit
    if version is not None and version < (0, 9):
        expected = is_scaled
    if not expected:
        raise StudyError(
            f"{path} states {stated} of Statismo's format, and the columns of its basis have "
            f"lengths of {np.sqrt(squares.min()):.4g} to {np.sqrt(squares.max()):.4g}. In version "
            f"0.8 they are the standard deviations ({np.sqrt(variances[kept].min()):.4g} to "
            f"{np.sqrt(variances.max()):.4g}), since 0.9 they are 1. Save the model again, or "
            "correct the version in the file."
        )
    if is_unit:
        return basis
    return basis / np.sqrt(np.where(kept, variances, 1.0))


def _array(file: h5py.Group, path: Path, name: str, dimensions: int) -> np.ndarray:
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


def _cases(file: h5py.Group, modes: int, columns: int) -> tuple[np.ndarray, tuple[str, ...]]:
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

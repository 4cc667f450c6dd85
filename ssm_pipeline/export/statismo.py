"""Statismo's HDF5 file (.h5), which Scalismo reads: posterior models, fitting, sampling."""

from __future__ import annotations

import io
from pathlib import Path

import h5py
import numpy as np

from ssm_pipeline import storage
from ssm_pipeline.shape_model.model import ShapeModel


def write_statismo(model: ShapeModel, path: Path, build_time: str) -> None:
    """The model in Statismo's format 0.9; the mean is also the reference mesh.

    Scalismo refuses every number type but float32 and int32, and strings of variable length.

    Args:
        build_time: As text, for the file's own record.

    Source: Lüthi et al. 2012 (Statismo); scalismo.io.StatismoIO, the reader of today.
    """
    buffer = io.BytesIO()  # HDF5's own writer prints tracebacks where the disk is full
    with h5py.File(buffer, "w") as file:
        file["version/majorVersion"] = np.int32(0)
        file["version/minorVersion"] = np.int32(9)

        representer = file.create_group("representer")
        representer.attrs["name"] = np.bytes_("itkStandardMeshRepresenter")
        representer.attrs["version"] = np.bytes_("0.9")
        representer.attrs["datasetType"] = np.bytes_("POLYGON_MESH")
        representer["points"] = model.mean.T.astype(np.float32)
        representer["cells"] = model.faces.T.astype(np.int32)

        pca = file.create_group("model")
        pca["mean"] = model.mean.ravel().astype(np.float32)  # x0 y0 z0 x1 …
        pca["pcaBasis"] = model.modes.reshape(model.mode_count, -1).T.astype(np.float32)
        pca["pcaVariance"] = model.variances.astype(np.float32)
        pca["noiseVariance"] = np.float32(0)

        info = file.create_group("modelinfo")
        info["build-time"] = np.bytes_(build_time)
        info["scores"] = model.scores.T.astype(np.float32)  # a column per case, in SD
        builder = info.create_group("modelBuilder-0")
        builder["builderName"] = np.bytes_("ssm-pipeline")
        builder["buildTime"] = np.bytes_(build_time)
        # The format has no field for space and unit; its readers show the parameters as they are.
        builder["parameters/space"] = np.bytes_("LPS")
        builder["parameters/unit"] = np.bytes_("mm")
        for index, case_id in enumerate(model.case_ids):
            builder[f"dataInfo/URI_{index}"] = np.bytes_(case_id.encode())
    storage.write_bytes(path, buffer.getbuffer())

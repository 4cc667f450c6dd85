"""Volume, area and extents of every case and of the model's extremes, as a table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ssm_pipeline.export.meshes import DEVIATIONS
from ssm_pipeline.geometry.surface import area, volume
from ssm_pipeline.records import Mesh
from ssm_pipeline.shape_model.model import ShapeModel


def measurements(
    model: ShapeModel,
    case_ids: Sequence[str],
    meshes: Sequence[Mesh],
    corresponded: np.ndarray,
) -> pd.DataFrame:
    """Measure every case, the mean, and each mode at ±2 SD.

    A corresponded surface has its vertices on the case's mesh and fewer triangles, which cut off
    what bulges out: it encloses slightly less. So a case has both volumes, and a shape of the model
    has only the second. Compare numbers of one column.

    Args:
        model: The model, which gives the mean and the modes.
        case_ids: N names.
        meshes: N meshes of the cases, as scanned, in mm.
        corresponded: `(N, V, 3)` mm, the cases' shapes on the triangles of the model.

    Returns:
        A row per shape. Columns: shape; volume_ml and area_cm2 of the case's own mesh;
        corresponded_volume_ml and corresponded_area_cm2 on the triangles of the model;
        left_right_mm, front_back_mm and up_down_mm, the extents along the scanner's axes. Shapes of
        the model lie as the model does.
    """
    rows = [
        {"shape": case_id}
        | _size(mesh.vertices, mesh.faces)
        | _size(vertices, model.faces, "corresponded_")
        | _extents(mesh.vertices)
        for case_id, mesh, vertices in zip(case_ids, meshes, corresponded, strict=True)
    ]
    rows.append(_of_the_model("mean", model.mean, model))
    for mode in range(model.mode_count):
        for sign, word in ((1, "plus"), (-1, "minus")):
            vertices = model.reconstruct(sign * DEVIATIONS * np.eye(model.mode_count)[mode])
            name = f"mode_{mode + 1}_{word}_{DEVIATIONS:.0f}sd"
            rows.append(_of_the_model(name, vertices, model))
    return pd.DataFrame(rows)


def _of_the_model(name: str, vertices: np.ndarray, model: ShapeModel) -> dict[str, object]:
    own: dict[str, object] = {"volume_ml": np.nan, "area_cm2": np.nan}
    size = _size(vertices, model.faces, "corresponded_")
    return {"shape": name} | own | size | _extents(vertices)


def _size(vertices: np.ndarray, faces: np.ndarray, prefix: str = "") -> dict[str, object]:
    return {
        f"{prefix}volume_ml": volume(vertices, faces) / 1000,
        f"{prefix}area_cm2": area(vertices, faces) / 100,
    }


def _extents(vertices: np.ndarray) -> dict[str, object]:
    names = ("left_right_mm", "front_back_mm", "up_down_mm")
    return dict(zip(names, np.ptp(vertices, axis=0), strict=True))

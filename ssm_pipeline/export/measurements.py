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
    model: ShapeModel, case_ids: Sequence[str], meshes: Sequence[Mesh]
) -> pd.DataFrame:
    """A row per case, by its own surface as scanned; then the mean, and each mode at ±2 SD.

    Columns: shape, volume_ml, area_cm2, and the extents along the scanner's axes:
    left_right_mm, front_back_mm, up_down_mm. Of the model's shapes those lie as the model does.
    """
    rows = [
        _row(case_id, mesh.vertices, mesh.faces)
        for case_id, mesh in zip(case_ids, meshes, strict=True)
    ]
    rows.append(_row("mean", model.mean, model.faces))
    for mode in range(model.mode_count):
        for sign, word in ((1, "plus"), (-1, "minus")):
            vertices = model.reconstruct(sign * DEVIATIONS * np.eye(model.mode_count)[mode])
            name = f"mode_{mode + 1}_{word}_{DEVIATIONS:.0f}sd"
            rows.append(_row(name, vertices, model.faces))
    return pd.DataFrame(rows)


def _row(name: str, vertices: np.ndarray, faces: np.ndarray) -> dict[str, object]:
    extents = np.ptp(vertices, axis=0)
    return {
        "shape": name,
        "volume_ml": volume(vertices, faces) / 1000,
        "area_cm2": area(vertices, faces) / 100,
        "left_right_mm": extents[0],
        "front_back_mm": extents[1],
        "up_down_mm": extents[2],
    }

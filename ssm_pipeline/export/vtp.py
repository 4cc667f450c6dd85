"""VTK XML (.vtp): the mean with its modes as vectors, for ParaView and 3D Slicer."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ssm_pipeline import storage
from ssm_pipeline.shape_model.model import ShapeModel


def write_vtp(model: ShapeModel, path: Path) -> None:
    """The mean shape; point array mode_<m>_plus_1sd_mm (V, 3) is what mode m adds at +1 SD.

    "Warp by vector" in ParaView, by a factor of s, shows the mean at s standard deviations.
    3D Slicer takes the space from the field array SPACE.
    """
    import pyvista

    mesh = pyvista.PolyData.from_regular_faces(model.mean, model.faces)
    displacements = model.modes * model.standard_deviations[:, None, None]
    for number, displacement in enumerate(displacements, start=1):
        mesh.point_data[f"mode_{number}_plus_1sd_mm"] = displacement.astype(np.float32)
    mesh.field_data["SPACE"] = ["LPS"]
    mesh.field_data["UNIT"] = ["mm"]
    with storage.written_whole(path) as temporary:
        mesh.save(temporary)

"""VTK XML (.vtp): the mean with its modes as vectors, for ParaView and 3D Slicer."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ssm_pipeline import storage
from ssm_pipeline.shape_model.model import ShapeModel

if TYPE_CHECKING:  # at run time inside the functions: it is heavy
    import pyvista


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
    write_poly_data(mesh, path)


def write_poly_data(mesh: pyvista.PolyData, path: Path) -> None:
    """By way of memory: VTK itself ends the process, or says nothing, where the disk is full."""
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

    writer = vtkXMLPolyDataWriter()
    writer.SetInputData(mesh)
    writer.SetDataModeToBinary()
    writer.WriteToOutputStringOn()
    writer.Write()
    storage.write_text(path, writer.GetOutputString())

"""PLY and VTP, read back by trimesh and VTK."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from posed_spheres import Spheres
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOPLY import vtkPLYReader
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader

from ssm_pipeline.export.meshes import write_meshes
from ssm_pipeline.export.vtp import write_vtp

# float32 at 300 mm: spacing 3e-5 mm.
ATOL = 5e-5


def test_meshes_are_the_mean_the_template_and_two_deviations(
    spheres: Spheres, tmp_path: Path
) -> None:
    template = spheres.shapes.vertices[0]
    written = write_meshes(spheres.model, template, tmp_path, modes=2)
    expected = {
        "mean": spheres.model.mean,
        "template": template,
        "mode_1_plus_2sd": spheres.model.reconstruct([2.0]),
        "mode_1_minus_2sd": spheres.model.reconstruct([-2.0]),
        "mode_2_plus_2sd": spheres.model.reconstruct([0.0, 2.0]),
        "mode_2_minus_2sd": spheres.model.reconstruct([0.0, -2.0]),
    }
    assert {path.stem for path in written} == set(expected)
    for path in written:
        mesh = trimesh.load_mesh(path, process=False)
        np.testing.assert_allclose(mesh.vertices, expected[path.stem], atol=ATOL)
        np.testing.assert_array_equal(mesh.faces, spheres.model.faces)
        assert mesh.volume > 0


def test_slicer_finds_the_space_where_it_looks(spheres: Spheres, tmp_path: Path) -> None:
    path, *_ = write_meshes(spheres.model, spheres.shapes.vertices[0], tmp_path)
    reader = vtkPLYReader()  # as 3D Slicer does
    reader.SetFileName(str(path))
    reader.Update()
    comments = reader.GetComments()
    said = [comments.GetValue(index) for index in range(comments.GetNumberOfValues())]
    assert any("SPACE=LPS" in comment for comment in said)
    points = vtk_to_numpy(reader.GetOutput().GetPoints().GetData())
    np.testing.assert_allclose(points, spheres.model.mean, atol=ATOL)


def test_a_model_of_few_modes_gives_as_many_meshes(spheres: Spheres, tmp_path: Path) -> None:
    written = write_meshes(spheres.model.truncate(1), spheres.shapes.vertices[0], tmp_path)
    assert len(written) == 4


def test_vtp_holds_the_modes_as_vectors(spheres: Spheres, tmp_path: Path) -> None:
    write_vtp(spheres.model, tmp_path / "model.vtp")
    reader = vtkXMLPolyDataReader()
    reader.SetFileName(str(tmp_path / "model.vtp"))
    reader.Update()
    mesh = reader.GetOutput()
    assert mesh.GetFieldData().GetAbstractArray("SPACE").GetValue(0) == "LPS"
    mean = vtk_to_numpy(mesh.GetPoints().GetData())
    arrays = mesh.GetPointData()
    assert arrays.GetNumberOfArrays() == spheres.model.mode_count
    second = vtk_to_numpy(arrays.GetArray("mode_2_plus_1sd_mm"))
    warped = mean - 1.5 * second
    np.testing.assert_allclose(warped, spheres.model.reconstruct([0.0, -1.5]), atol=ATOL)
    assert mesh.GetNumberOfPolys() == len(spheres.model.faces)

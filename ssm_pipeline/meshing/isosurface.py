"""Level set of a field → triangles in world millimetres."""

from __future__ import annotations

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonDataModel import vtkImageData
from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D

from ssm_pipeline.geometry.surface import volume
from ssm_pipeline.geometry.topology import face_components
from ssm_pipeline.meshing.smooth_field import SmoothField
from ssm_pipeline.records import Mesh


def isosurface(field: SmoothField, case_id: str) -> Mesh:
    """The largest piece of {values = level}, outward oriented. Source: Schroeder 2015."""
    image = vtkImageData()
    image.SetDimensions(*field.values.shape[::-1])
    image.GetPointData().SetScalars(numpy_to_vtk(field.values.ravel()))
    extractor = vtkFlyingEdges3D()
    extractor.SetInputData(image)
    extractor.SetValue(0, field.level)
    extractor.ComputeNormalsOff()
    extractor.ComputeGradientsOff()
    extractor.ComputeScalarsOff()
    extractor.Update()
    surface = extractor.GetOutput()
    points = vtk_to_numpy(surface.GetPoints().GetData()).astype(np.float64)
    faces = vtk_to_numpy(surface.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    vertices = (points * field.voxel_mm) @ field.direction.T + field.origin_mm
    return largest_piece(Mesh(vertices, faces, case_id))


def largest_piece(mesh: Mesh) -> Mesh:
    """The connected piece with the most faces, unused vertices dropped, oriented outward."""
    piece = face_components(mesh.faces)
    faces = mesh.faces[piece == np.bincount(piece).argmax()]
    used, local = np.unique(faces, return_inverse=True)
    vertices, faces = mesh.vertices[used], local.reshape(-1, 3)
    if volume(vertices, faces) < 0:  # a mirrored image direction turns the triangles
        faces = faces[:, ::-1]
    return Mesh(vertices, np.ascontiguousarray(faces), mesh.case_id)

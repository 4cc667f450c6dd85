"""What of a mask is missing in its mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
from vtkmodules.vtkImagingStencil import vtkImageStencilToImage, vtkPolyDataToImageStencil

from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.records import Mask, Mesh


@dataclass(frozen=True, eq=False)
class Piece:
    """A connected group of voxels on the wrong side of the mesh, far from its surface.

    Attributes:
        volume_ml: Of the voxels that lie farther from the mesh than the tolerance.
        depth_mm: The largest distance of their centres from the mesh.
        length_mm: The diagonal of their bounding box.
        centre_mm: (3,) LPS, their mean.
        voxels: (n, 3) indices z, y, x.
    """

    volume_ml: float
    depth_mm: float
    length_mm: float
    centre_mm: np.ndarray
    voxels: np.ndarray


def lost_pieces(mesh: Mesh, organ: Mask, tolerance_mm: float) -> tuple[Piece, ...]:
    """Parts of the organ outside the mesh, the largest first.

    A voxel counts if its centre lies outside, farther than tolerance_mm from the mesh.
    """
    inside = inside_mesh(mesh, organ)
    return _pieces(organ.voxels & ~inside, inside, mesh, organ, tolerance_mm)


def inside_mesh(mesh: Mesh, organ: Mask) -> np.ndarray:
    """(Z, Y, X) bool: the voxels of the organ's image whose centres lie inside the mesh."""
    local = ((mesh.vertices - organ.origin_mm) @ organ.direction) / organ.spacing_mm
    surface = vtkPolyData()
    points = vtkPoints()
    points.SetData(numpy_to_vtk(np.ascontiguousarray(local), deep=True))
    surface.SetPoints(points)
    cells = vtkCellArray()
    cells.SetData(
        numpy_to_vtkIdTypeArray(3 * np.arange(len(mesh.faces) + 1, dtype=np.int64), deep=True),
        numpy_to_vtkIdTypeArray(np.ascontiguousarray(mesh.faces.ravel(), np.int64), deep=True),
    )
    surface.SetPolys(cells)
    shape = organ.voxels.shape
    stencil = vtkPolyDataToImageStencil()
    stencil.SetInputData(surface)
    stencil.SetOutputWholeExtent(0, shape[2] - 1, 0, shape[1] - 1, 0, shape[0] - 1)
    image = vtkImageStencilToImage()
    image.SetInputConnection(stencil.GetOutputPort())
    image.SetOutputScalarTypeToUnsignedChar()
    image.SetInsideValue(1)
    image.Update()
    values = vtk_to_numpy(image.GetOutput().GetPointData().GetScalars())
    return np.asarray(values.reshape(shape) > 0)


def _pieces(
    wrong: np.ndarray, right: np.ndarray, mesh: Mesh, organ: Mask, tolerance_mm: float
) -> tuple[Piece, ...]:
    index = _away_from(right, np.argwhere(wrong), organ.spacing_mm, tolerance_mm)
    if len(index) == 0:
        return ()
    world = organ.to_world(index[:, ::-1].astype(float))
    distances = closest_points(world, mesh.vertices, mesh.faces).distances
    far = distances > tolerance_mm
    index, world, distances = index[far], world[far], distances[far]
    if len(index) == 0:
        return ()
    low = index.min(axis=0)
    box = np.zeros(index.max(axis=0) - low + 1, bool)
    box[tuple((index - low).T)] = True
    label = ndimage.label(box, structure=np.ones((3, 3, 3)))[0][tuple((index - low).T)]
    voxel_ml = float(np.prod(organ.spacing_mm)) / 1000
    found = []
    for number in range(1, label.max() + 1):
        of_it = label == number
        extent = np.ptp(index[of_it], axis=0)[::-1] + 1
        found.append(
            Piece(
                volume_ml=float(of_it.sum()) * voxel_ml,
                depth_mm=float(distances[of_it].max()),
                length_mm=float(np.linalg.norm(extent * organ.spacing_mm)),
                centre_mm=world[of_it].mean(axis=0),
                voxels=index[of_it],
            )
        )
    return tuple(sorted(found, key=lambda piece: -piece.volume_ml))


def _away_from(
    inside: np.ndarray, index: np.ndarray, spacing_mm: np.ndarray, tolerance_mm: float
) -> np.ndarray:
    """Of voxels outside the mesh, those without an inner voxel within the tolerance along an axis.

    Between an outer and an inner voxel lies the surface: the others are near it, and need no
    exact distance.
    """
    shape = np.array(inside.shape)
    for axis in range(3):
        reach = int(tolerance_mm / spacing_mm[2 - axis])
        for step in [s for s in range(-reach, reach + 1) if s != 0]:
            other = index.copy()
            other[:, axis] += step
            valid = (other[:, axis] >= 0) & (other[:, axis] < shape[axis])
            near = np.zeros(len(index), bool)
            near[valid] = inside[tuple(other[valid].T)]
            index = index[~near]
    return index

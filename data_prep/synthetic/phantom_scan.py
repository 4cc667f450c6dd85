"""A surface as a scanner and a segmentation leave it: voxels, their noise, bridges, a cut view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import SimpleITK as sitk
from scipy import ndimage
from scipy.spatial import cKDTree
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
from vtkmodules.vtkImagingStencil import vtkImageStencilToImage, vtkPolyDataToImageStencil

_MARGIN = 4  # voxels around the organ
_BLUR = 0.5  # voxels, the scanner's and the segmentation's
_FARTHEST_NOISE = 0.4  # of the occupancy: beyond the blur of the border nothing is flipped


@dataclass(frozen=True, eq=False)
class Handle:
    """A bridge over a surface, or a tunnel beneath it: a bent rod through path (3, 3) mm."""

    path: np.ndarray
    radius_mm: float
    is_bridge: bool


@dataclass(frozen=True, eq=False)
class Grid:
    """Voxel centres: origin (3,) mm LPS, spacing (3,) mm and size (3,) int along x, y, z."""

    origin: np.ndarray
    spacing: np.ndarray
    size: np.ndarray

    def axes(self) -> list[np.ndarray]:
        return [
            o + s * np.arange(n)
            for o, s, n in zip(self.origin, self.spacing, self.size, strict=True)
        ]

    def image(self, voxels: np.ndarray) -> sitk.Image:
        image = sitk.GetImageFromArray(voxels)
        image.SetSpacing(self.spacing.tolist())
        image.SetOrigin(self.origin.tolist())
        return image


@dataclass(frozen=True)
class Slab:
    """The heights that a field of view shows, z from low_mm to high_mm in patient space."""

    low_mm: float = -np.inf
    high_mm: float = np.inf

    def holds(self, points: np.ndarray) -> np.ndarray:
        """(V, 3) mm → (V,) bool."""
        return (points[:, 2] > self.low_mm) & (points[:, 2] < self.high_mm)

    def within(self, grid: Grid) -> Grid:
        """The slices of the grid whose centres lie in the slab."""
        z = grid.axes()[2]
        first, last = np.searchsorted(z, [self.low_mm, self.high_mm])
        lowest = grid.origin + np.array([0, 0, first * grid.spacing[2]])
        return Grid(lowest, grid.spacing, np.array([*grid.size[:2], last - first]))


def grid_around(
    vertices: np.ndarray, spacing_mm: tuple[float, float, float], shift: np.ndarray
) -> Grid:
    """A grid that holds the surface; shift (3,), in voxels: where it lies on the voxels."""
    spacing = np.array(spacing_mm)
    origin = vertices.min(axis=0) - (_MARGIN + shift) * spacing
    size = np.ceil((vertices.max(axis=0) - origin) / spacing).astype(int) + _MARGIN + 1
    return Grid(origin, spacing, size)


def occupancy(vertices: np.ndarray, faces: np.ndarray, grid: Grid) -> np.ndarray:
    """(Z, Y, X) float32: the share of every voxel that lies inside a closed surface.

    Counted on a finer grid, finest along the coarsest axis: about 0.6 of the finest voxel edge.
    """
    fine = np.maximum(2, np.round(grid.spacing / (0.6 * grid.spacing.min()))).astype(int)
    spacing = grid.spacing / fine
    first = grid.origin - grid.spacing / 2 + spacing / 2
    voxels = inside(vertices, faces, Grid(first, spacing, grid.size * fine))
    x, y, z = fine
    nx, ny, nz = grid.size
    blocks = voxels.reshape(nz, z, ny, y, nx * x)
    counts = blocks.sum(axis=(1, 3), dtype=np.uint8).reshape(nz, ny, nx, x).sum(axis=3)
    result: np.ndarray = (counts / np.float32(x * y * z)).astype(np.float32)
    return result


def segmented(
    share: np.ndarray,
    grid: Grid,
    handles: tuple[Handle, ...],
    noise: float,
    generator: np.random.Generator,
) -> np.ndarray:
    """(Z, Y, X) bool: occupancy with its handles, blurred and disturbed, above one half.

    Args:
        noise: Standard deviation of what is added to the blurred occupancy; correlated over about a
            voxel, and too small to flip what lies away from the border.
    """
    for handle in handles:
        share = _with_handle(share, grid, handle)
    blurred = ndimage.gaussian_filter(share, _BLUR)
    near = (blurred > 0.05) & (blurred < 0.95)
    disturbance = ndimage.gaussian_filter(
        generator.standard_normal(share.shape, dtype=np.float32), 0.7
    )
    disturbance *= noise / disturbance.std()
    limited = np.clip(disturbance, -_FARTHEST_NOISE, _FARTHEST_NOISE)
    result: np.ndarray = np.where(near, blurred + limited, blurred) > 0.5
    return result


def two_labels(
    voxels: np.ndarray, grid: Grid, vertices: np.ndarray, border: np.ndarray
) -> np.ndarray:
    """(Z, Y, X) uint8: 1 where the nearest surface points lie before the border, 2 beyond.

    Args:
        border: (V,) mm, negative before; interpolated between the four nearest vertices, on a grid
            of at most 50 000 points that all voxels are read from.
    """
    stride = max(1, int(np.ceil((voxels.size / 50_000) ** (1 / 3))))
    coarse = [axis[::stride] for axis in grid.axes()]
    z, y, x = np.meshgrid(*coarse[::-1], indexing="ij")
    distance, nearest = cKDTree(vertices).query(np.stack([x, y, z], axis=-1), k=4)
    weights = 1 / (distance + 1e-3)
    side = (weights * border[nearest]).sum(axis=-1) / weights.sum(axis=-1)
    where = np.argwhere(voxels)
    values = ndimage.map_coordinates(side, where.T / stride, order=1, mode="nearest")
    labels = np.zeros(voxels.shape, np.uint8)
    labels[tuple(where.T)] = np.where(values < 0, 1, 2)
    return labels


def inside(vertices: np.ndarray, faces: np.ndarray, grid: Grid) -> np.ndarray:
    """(Z, Y, X) bool: voxel centres within a closed surface (mm LPS)."""
    surface, points, cells = vtkPolyData(), vtkPoints(), vtkCellArray()
    points.SetData(numpy_to_vtk(np.ascontiguousarray(vertices)))
    cells.SetData(3, numpy_to_vtkIdTypeArray(np.ascontiguousarray(faces).ravel(), deep=True))
    surface.SetPoints(points)
    surface.SetPolys(cells)
    stencil = vtkPolyDataToImageStencil()
    stencil.SetInputData(surface)
    stencil.SetOutputOrigin(*grid.origin)
    stencil.SetOutputSpacing(*grid.spacing)
    nx, ny, nz = grid.size
    stencil.SetOutputWholeExtent(0, nx - 1, 0, ny - 1, 0, nz - 1)
    stencil.SetTolerance(0)
    filled = vtkImageStencilToImage()
    filled.SetInputConnection(stencil.GetOutputPort())
    filled.SetInsideValue(1)
    filled.SetOutsideValue(0)
    filled.SetOutputScalarTypeToUnsignedChar()
    filled.Update()
    scalars = filled.GetOutput().GetPointData().GetScalars()
    result: np.ndarray = vtk_to_numpy(scalars).reshape(nz, ny, nx).astype(bool)
    return result


def _with_handle(share: np.ndarray, grid: Grid, handle: Handle) -> np.ndarray:
    """Occupancy (Z, Y, X) with the rod laid on, or bored out."""
    reach = handle.radius_mm + 2 * grid.spacing
    low = np.floor((handle.path.min(axis=0) - reach - grid.origin) / grid.spacing).astype(int)
    high = np.ceil((handle.path.max(axis=0) + reach - grid.origin) / grid.spacing).astype(int)
    low, high = np.clip(low, 0, grid.size), np.clip(high, 0, grid.size)
    box = tuple(slice(a, b) for a, b in zip(low[::-1], high[::-1], strict=True))
    axes = [axis[a:b] for axis, a, b in zip(grid.axes(), low, high, strict=True)]
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    ends = np.linspace(0, 2, 41)
    rod = np.column_stack([np.interp(ends, [0, 1, 2], handle.path[:, axis]) for axis in range(3)])
    distance = cKDTree(rod).query(points)[0].reshape(x.shape)
    filled = np.clip((handle.radius_mm - distance) / grid.spacing.min() + 0.5, 0, 1)
    changed = share.copy()
    if handle.is_bridge:
        changed[box] = np.maximum(share[box], filled)
    else:
        changed[box] = np.minimum(share[box], 1 - filled)
    return changed

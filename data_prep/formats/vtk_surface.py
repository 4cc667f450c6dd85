"""VTK's `.vtk`, `.vtp` and `.vtu` surfaces, read in a process of their own.

VTK 9.7's readers end the process that they run in on some damaged files: a segmentation fault, or
all memory asked for at once. This file is also the program of that process, so that it imports
nothing but NumPy, psutil and VTK.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil

LONGEST_S = 600
_HEADER_BYTES = 4096  # a legacy file names its kind of data there
MEMORY_BYTES, MEMORY_PER_BYTE = 2 * 2**30, 30  # of the file: text is read into numbers and lists


class UnreadableSurface(ValueError):
    """What VTK, or the end of its process, says of a file."""


def read_vtk(path: Path) -> tuple[np.ndarray, np.ndarray, str | None]:
    """Vertices (V, 3), triangles (F, 3), and the space that the file names, LPS, RAS or None.

    Raises UnreadableSurface.
    """
    with tempfile.TemporaryDirectory() as folder:
        found = Path(folder) / "surface.npz"
        command = [sys.executable, __file__, str(path.resolve()), str(found)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST_S)
        except subprocess.TimeoutExpired as error:
            raise UnreadableSurface(f"reading it takes over {LONGEST_S} s") from error
        if done.returncode < 0:
            raise UnreadableSurface("VTK breaks down on it")
        if done.returncode:
            raise UnreadableSurface((done.stdout.strip().splitlines() or ["VTK refuses it"])[-1])
        with np.load(found) as file:
            return file["vertices"], file["faces"], str(file["space"]) or None


def _read_here(path: str) -> tuple[np.ndarray, np.ndarray, str]:
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkFiltersCore import vtkTriangleFilter
    from vtkmodules.vtkIOLegacy import vtkPolyDataReader, vtkUnstructuredGridReader
    from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLUnstructuredGridReader

    start = Path(path).read_bytes()[:_HEADER_BYTES]
    reader: Any = vtkXMLPolyDataReader() if path.lower().endswith(".vtp") else vtkPolyDataReader()
    if path.lower().endswith(".vtu"):
        reader = vtkXMLUnstructuredGridReader()
    elif b"DATASET UNSTRUCTURED_GRID" in start.upper():
        reader = vtkUnstructuredGridReader()
    reader.SetFileName(path)
    with _vtk_errors() as errors:
        reader.Update()
    surface = reader.GetOutput()
    if surface.IsA("vtkUnstructuredGrid") and not errors:
        surface = _surface_of_grid(surface)
    count = surface.GetNumberOfPoints()
    corners = vtk_to_numpy(surface.GetPolys().GetConnectivityArray())
    # VTK fills up what a cut-off file lacks with whatever the memory held.
    if corners.size and (corners.min() < 0 or corners.max() >= count):
        errors.append("faces name missing vertices")
    if errors:
        raise UnreadableSurface(errors[0])
    triangles = vtkTriangleFilter()  # also cuts strips and polygons into triangles
    triangles.PassLinesOff()
    triangles.PassVertsOff()
    triangles.SetInputData(surface)
    triangles.Update()
    surface = triangles.GetOutput()
    if not count:
        return np.empty((0, 3)), np.empty((0, 3), np.int64), ""
    faces = vtk_to_numpy(surface.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    vertices = vtk_to_numpy(surface.GetPoints().GetData()).astype(np.float64)
    note = surface.GetFieldData().GetAbstractArray("SPACE")  # 3D Slicer's, in a .vtp
    space = str(note.GetValue(0)) if note is not None and note.GetNumberOfValues() else ""
    return vertices, faces.astype(np.int64), space if space in ("LPS", "RAS") else ""


def _surface_of_grid(grid: Any) -> Any:
    """The faces of a grid that has no solid cells."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkFiltersGeometry import vtkGeometryFilter

    cells = grid.GetCells()
    corners = vtk_to_numpy(cells.GetConnectivityArray()) if cells else np.empty(0)
    if corners.size and (corners.min() < 0 or corners.max() >= grid.GetNumberOfPoints()):
        raise UnreadableSurface("faces name missing vertices")
    solid = [i for i in range(grid.GetNumberOfCells()) if grid.GetCell(i).GetCellDimension() > 2]
    if solid:
        raise UnreadableSurface(f"{len(solid)} of its cells are solids; save their surface alone")
    faces = vtkGeometryFilter()
    faces.MergingOff()
    faces.SetInputData(grid)
    faces.Update()
    return faces.GetOutput()


@contextmanager
def _vtk_errors() -> Iterator[list[str]]:
    """What VTK complains of inside the block, instead of on the terminal."""
    from vtkmodules.vtkCommonCore import vtkLogger, vtkOutputWindow, vtkStringOutputWindow

    window = vtkStringOutputWindow()
    errors: list[str] = []
    vtkOutputWindow.SetInstance(window)
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    yield errors
    # One of its messages is a warning by rank and an error by its words; other warnings are
    # of attributes that no surface needs.
    said = window.GetOutput()  # bytes, where a damaged file is quoted
    text = said.decode("latin-1") if isinstance(said, bytes) else said
    errors += re.findall(r"Error (?:reading|parsing)[^\n]*", text)


def _limit_memory(file_bytes: int) -> None:
    own = psutil.Process()
    if not hasattr(own, "rlimit"):  # Linux alone has such limits
        return
    most = own.memory_info().vms + MEMORY_BYTES + MEMORY_PER_BYTE * file_bytes
    own.rlimit(psutil.RLIMIT_AS, (most, most))


def main() -> int:
    path, found = sys.argv[1:]
    _limit_memory(Path(path).stat().st_size)
    try:
        vertices, faces, space = _read_here(path)
    except (UnreadableSurface, MemoryError, TypeError, AttributeError) as error:
        print(str(error) or type(error).__name__)
        return 1
    np.savez(found, vertices=vertices, faces=faces, space=space)
    return 0


if __name__ == "__main__":
    sys.exit(main())

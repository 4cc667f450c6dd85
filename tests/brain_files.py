"""GIFTI and FreeSurfer surfaces, and PLY strips, for tests."""

from __future__ import annotations

from pathlib import Path

import nibabel as nib
import numpy as np
from nibabel.freesurfer.io import write_geometry
from nibabel.gifti.gifti import GiftiCoordSystem, GiftiDataArray, GiftiImage, GiftiMetaData

TILTED = np.array([[-0.8, 0.6, 0], [0, 0, -1.0], [0.6, 0.8, 0]])  # rows: xras, yras, zras
CENTRE = np.array([5.0, -7.0, 11.0])
CONFORMED = np.array([[-1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def write_freesurfer(
    path: Path, vertices: np.ndarray, faces: np.ndarray, axes: np.ndarray | None = CONFORMED
) -> Path:
    """As FreeSurfer has it; without the volume's position if `axes` is None."""
    volume = {
        "head": np.array([2, 0, 20], np.int32),
        "valid": "1  # volume info valid",
        "filename": "../mri/filled.mgz",
        "volume": np.array([256, 256, 256]),
        "voxelsize": np.ones(3),
    }
    if axes is not None:
        rows = dict(zip(("xras", "yras", "zras", "cras"), [*axes, CENTRE], strict=True))
    arguments = None if axes is None else volume | rows
    write_geometry(path, vertices, faces, "created by a test", arguments)
    return path


def write_gifti(
    path: Path, vertices: np.ndarray, faces: np.ndarray, notes: dict[str, str] | None = None
) -> Path:
    system = GiftiCoordSystem(dataspace=0, xformspace=0)
    points = GiftiDataArray(
        vertices.astype(np.float32),
        intent="NIFTI_INTENT_POINTSET",
        coordsys=system,
        meta=GiftiMetaData(notes or {}),
    )
    triangles = GiftiDataArray(faces.astype(np.int32), intent="NIFTI_INTENT_TRIANGLE")
    nib.save(GiftiImage(darrays=[points, triangles]), path)
    return path


def write_ply_strips(path: Path, binary: bool = False) -> Path:
    """Two strips: a band of two triangles, and one triangle."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 2, 1]], "<f4")
    strip = np.array([0, 1, 2, 3, -1, 2, 3, 4, -1], "<i4")
    header = (
        f"ply\nformat {'binary_little_endian' if binary else 'ascii'} 1.0\nelement vertex 5\n"
        "property float x\nproperty float y\nproperty float z\n"
        "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    ).encode()
    if binary:
        body = vertices.tobytes() + np.array([len(strip)], "<i4").tobytes() + strip.tobytes()
    else:
        rows = [*vertices.tolist(), [len(strip), *strip.tolist()]]
        body = "".join(" ".join(map(str, row)) + "\n" for row in rows).encode()
    path.write_bytes(header + body)
    return path

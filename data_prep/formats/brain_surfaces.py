"""GIFTI and FreeSurfer surfaces, in scanner coordinates (RAS, mm)."""

from __future__ import annotations

import os
import struct
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ssm_pipeline.data_prep.formats.vtk_surface import UnreadableSurface

_TRIANGLES = b"\xff\xff\xfe"  # the first bytes of a FreeSurfer surface
_LONGEST_NOTE = 4096  # of the text that follows them
_REAL_RAS = (2, 1)  # the tag of a surface that is in scanner coordinates already
_CONFORMED = np.array([[-1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # columns: axes of surface space


def is_freesurfer(path: Path) -> bool:
    """True for a FreeSurfer surface, by its first bytes: its name has no fixed suffix."""
    if not path.is_file() or not os.access(path, os.R_OK):
        return False
    with path.open("rb") as file:
        return file.read(3) == _TRIANGLES


def read_freesurfer(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) in scanner RAS, and faces (F, 3).

    FreeSurfer stores vertices relative to the centre of the volume. The end of the file holds that
    centre (`cras`) and the directions of the volume's axes.

    Raises:
        UnreadableSurface: For a file that is damaged or does not hold the volume's position.

    Source: FreeSurfer, `utils/mrisurf_io.cpp` and `MRIxfmCRS2XYZtkreg`.
    """
    from nibabel.freesurfer.io import read_geometry

    content = path.read_bytes()
    counts_at = content.find(b"\n\n", 3, _LONGEST_NOTE) + 2
    if counts_at < 2 or len(content) < counts_at + 8:
        raise UnreadableSurface("its header does not end")
    vertex_count, face_count = struct.unpack(">ii", content[counts_at : counts_at + 8])
    end = counts_at + 8 + 12 * (vertex_count + face_count)
    if vertex_count < 0 or face_count < 0 or len(content) < end:
        raise UnreadableSurface(
            f"it promises {vertex_count} vertices and {face_count} faces in {len(content)} bytes"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of files without a volume; these are refused below
            vertices, faces, volume = read_geometry(path, read_metadata=True)
        vertices, faces = np.asarray(vertices, float), np.asarray(faces, np.int64)
        tag = struct.unpack(">ii", content[end : end + 8]) if len(content) >= end + 8 else None
        if tag != _REAL_RAS:
            if not str(volume.get("valid", "")).startswith("1"):
                raise UnreadableSurface(
                    "it does not hold the position of its volume, c_ras; write it again with "
                    "mris_convert --to-scanner"
                )
            axes = [volume[name] for name in ("xras", "yras", "zras")]
            vertices = _in_scanner(vertices, np.array(axes, float).T, volume["cras"])
    except UnreadableSurface:
        raise
    except (ValueError, LookupError, TypeError, OSError, EOFError) as error:
        raise UnreadableSurface(str(error)) from error
    return _checked(vertices, faces)


def read_gifti(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) in scanner RAS, and faces (F, 3).

    GIFTI files of FreeSurfer state the centre of their volume, unless they are in scanner
    coordinates already.

    Raises:
        UnreadableSurface: For a file that is damaged or does not hold one surface.
    """
    import nibabel
    from nibabel.gifti.gifti import GiftiImage

    try:
        image = GiftiImage.from_filename(path)
        points = image.get_arrays_from_intent("NIFTI_INTENT_POINTSET")
        triangles = image.get_arrays_from_intent("NIFTI_INTENT_TRIANGLE")
        if len(points) != 1 or len(triangles) > 1:
            raise UnreadableSurface(
                f"it holds {len(points)} sets of vertices and {len(triangles)} of triangles; one "
                "of each is needed, as in a .surf.gii"
            )
        vertices = np.asarray(points[0].data, float).reshape(-1, 3)
        faces = np.asarray(triangles[0].data if triangles else (), np.int64).reshape(-1, 3)
        system, notes = points[0].coordsys, dict(points[0].meta)
        space = nibabel.nifti1.xform_codes.label[system.dataspace] if system else "unknown"
        if space != "scanner" and "VolGeomC_R" in notes:
            axes, centre = _freesurfer_notes(notes)
            vertices = _in_scanner(vertices, axes, centre)
    except UnreadableSurface:
        raise
    except Exception as error:  # nibabel's reader raises whatever the damage happens to break
        raise UnreadableSurface(f"{type(error).__name__}: {error}") from error
    return _checked(vertices, faces)


def _freesurfer_notes(notes: Mapping[str, str]) -> tuple[np.ndarray, list[float]]:
    def of(name: str) -> list[float]:
        return [float(notes[f"VolGeom{name}_{axis}"]) for axis in "RAS"]

    return np.array([of("X"), of("Y"), of("Z")]).T, of("C")


def _in_scanner(vertices: np.ndarray, axes: np.ndarray, centre: object) -> np.ndarray:
    """Surface coordinates in scanner coordinates; `axes` (3, 3) are the volume's, as columns."""
    if not np.allclose(axes.T @ axes, np.eye(3), atol=1e-3):
        raise UnreadableSurface("the axes of its volume are not perpendicular")
    result: np.ndarray = vertices @ (axes @ _CONFORMED.T).T + np.asarray(centre, float)
    return result


def _checked(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise UnreadableSurface("faces name missing vertices")
    return vertices, faces

"""ShapeWorks project (.swproj): each case's surface and its particles, for ShapeWorks Studio."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ssm_pipeline import storage
from ssm_pipeline.export.meshes import write_ply
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records import CorrespondedShapes, Mesh


def matrix_of(frame: Similarity) -> np.ndarray:
    """(4, 4) of a frame, for columns (x, y, z, 1)."""
    matrix = np.eye(4)
    matrix[:3, :3] = frame.scale * frame.rotation
    matrix[:3, 3] = frame.translation
    return matrix


def write_project(
    shapes: CorrespondedShapes, frames: Sequence[Similarity], meshes: Sequence[Mesh], path: Path
) -> list[Path]:
    """The project, and beside it surfaces/<case>.ply and particles/<case>_{local,world}.particles.

    Args:
        shapes: The corresponded shapes, each in its own millimetres: the local particles.
        frames: Per case of `shapes`, to the model's millimetres: the world particles.
        meshes: Per case of `shapes`, its own surface in its own millimetres.

    Returns:
        The paths written, the project last. `alignment_1` is the frame; `procrustes_1`, which
        ShapeWorks applies after it, has nothing left to do. All values are strings, matrices row by
        row: ShapeWorks' reader takes nothing else.

    Source: ShapeWorks 6.5, JsonProjectReader.
    """
    folder = path.parent
    identity, written, subjects = np.eye(4), [], []
    for case_id, points, frame, mesh in zip(
        shapes.case_ids, shapes.vertices, frames, meshes, strict=True
    ):
        surface = folder / "surfaces" / f"{case_id}.ply"
        local = folder / "particles" / f"{case_id}_local.particles"
        world = folder / "particles" / f"{case_id}_world.particles"
        write_ply(mesh.vertices, mesh.faces, surface)
        _write_particles(points, local)
        _write_particles(frame.apply(points), world)
        written += [surface, local, world]
        subjects.append(
            {
                "name": case_id,
                "shape_1": _relative(surface, folder),
                "groomed_1": _relative(surface, folder),
                "local_particles_1": _relative(local, folder),
                "world_particles_1": _relative(world, folder),
                "alignment_1": _row_by_row(matrix_of(frame)),
                "procrustes_1": _row_by_row(identity),
            }
        )
    storage.write_json(path, {"data": subjects, "project": {"version": "2"}})
    return [*written, path]


def _write_particles(points: np.ndarray, path: Path) -> None:
    with storage.written_whole(path) as temporary:
        np.savetxt(temporary, points, fmt="%.9g")


def _relative(path: Path, folder: Path) -> str:
    return path.relative_to(folder).as_posix()


def _row_by_row(matrix: np.ndarray) -> str:
    return " ".join(f"{value:.17g}" for value in matrix.ravel())

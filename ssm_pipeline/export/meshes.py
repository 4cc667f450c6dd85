"""Surfaces as PLY: the mean, the template, and what the modes do to the mean."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ssm_pipeline import storage
from ssm_pipeline.shape_model.model import ShapeModel

DEVIATIONS = 2.0


def ply_bytes(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    """A binary PLY of vertices (V, 3) mm LPS and faces (F, 3).

    3D Slicer looks for `SPACE=LPS` in the comments. Coordinates are float32: at 500 mm from the
    scanner's centre that is 0.00003 mm.
    """
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        "comment SPACE=LPS\ncomment UNIT=mm\n"
        f"element vertex {len(vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    rows = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", (3,))])
    rows["count"], rows["corners"] = 3, faces
    return header.encode("ascii") + vertices.astype("<f4").tobytes() + rows.tobytes()


def write_ply(vertices: np.ndarray, faces: np.ndarray, path: Path) -> None:
    """Write `ply_bytes` to `path`, whole or not at all."""
    with storage.written_whole(path) as temporary:
        temporary.write_bytes(ply_bytes(vertices, faces))


def write_meshes(
    model: ShapeModel, template: np.ndarray, folder: Path, modes: int = 5
) -> list[Path]:
    """mean.ply, template.ply, and mode_<m>_plus_2sd.ply, mode_<m>_minus_2sd.ply.

    Args:
        template: (V, 3) mm in the template's own scanner space, where landmarks are placed on it
            and its images lie under it. All others are in the model's frame.
        modes: How many leading modes, or fewer where the model has fewer.

    Returns:
        The paths written. All meshes share one numbering of vertices and faces.
    """
    surfaces = {"mean": model.mean, "template": template}
    for mode in range(min(modes, model.mode_count)):
        scores = np.eye(model.mode_count)[mode] * DEVIATIONS
        for word, sign in (("plus", 1), ("minus", -1)):
            name = f"mode_{mode + 1}_{word}_{DEVIATIONS:.0f}sd"
            surfaces[name] = model.reconstruct(sign * scores)
    written = []
    for name, vertices in surfaces.items():
        written.append(folder / f"{name}.ply")
        write_ply(vertices, model.faces, written[-1])
    return written

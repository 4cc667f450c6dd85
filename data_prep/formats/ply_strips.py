"""PLY files whose triangles are strips."""

from __future__ import annotations

import io
import re

import numpy as np


def has_strips(content: bytes) -> bool:
    """True for a PLY whose header lists triangle strips."""
    return re.search(rb"^element tristrips [1-9]", content[:4096], re.MULTILINE) is not None


def read_strips(content: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) and faces (F, 3); -1 in a strip begins the next one.

    Raises:
        ValueError: For strips that name missing vertices. trimesh raises others for damage.
    """
    from trimesh.exchange.ply import load_ply

    read = load_ply(io.BytesIO(content))
    strips = read["metadata"]["_ply_raw"]["tristrips"]["data"]["vertex_indices"]
    if strips.dtype.names:  # binary files: a record of the length and the numbers
        strips = strips[strips.dtype.names[-1]]
    vertices = np.asarray(read["vertices"], float).reshape(-1, 3)
    faces: list[list[int]] = []
    for strip in strips:
        corners: list[int] = []
        for corner in np.asarray(strip).ravel().tolist():
            if not -1 <= corner < len(vertices):
                raise ValueError(f"a strip names vertex {corner} of {len(vertices)}")
            if corner < 0:
                corners = []
                continue
            corners.append(corner)
            if len(corners) > 2 and len(set(corners[-3:])) == 3:
                a, b, c = corners[-3:]
                # Every second triangle of a strip is turned over.
                faces.append([a, b, c] if len(corners) % 2 else [b, a, c])
    return vertices, np.array(faces, np.int64).reshape(-1, 3)

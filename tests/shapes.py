"""Small shapes that tests of several rooms share."""

from __future__ import annotations

import fast_simplification
import numpy as np
import trimesh

from ssm_pipeline.records import Mesh, SpectralBasis
from ssm_pipeline.spectral.basis import spectral_basis
from ssm_pipeline.spectral.settings import SpectralSettings


def sphere(radius: float = 1.0, subdivisions: int = 3, case_id: str = "sphere") -> Mesh:
    ball = trimesh.creation.icosphere(subdivisions)
    return Mesh(radius * ball.vertices, ball.faces, case_id)


def blob(seed: int, faces: int = 600, case_id: str | None = None) -> Mesh:
    """A closed, uneven, left-right different solid of about 100 mm, triangulated its own way."""
    generator = np.random.default_rng(seed)
    ball = trimesh.creation.icosphere(4)
    points = ball.vertices * [1.0, 1.3, 1.9]
    points = points * (1 + 0.25 * np.sin(points @ [[1.1], [-0.7], [1.6]] + 0.4))
    points = points * (1 + 0.08 * np.sin(points @ generator.standard_normal((3, 1))))
    vertices, triangles = fast_simplification.simplify(
        np.ascontiguousarray(points, dtype=np.float32),
        ball.faces.astype(np.int32),
        target_count=faces,
    )
    return Mesh(25.0 * vertices, triangles, case_id or f"blob{seed}")


def basis_of(mesh: Mesh, eigenpairs: int = 20) -> SpectralBasis:
    return spectral_basis(mesh, SpectralSettings(eigenpairs=eigenpairs))


def bar_mesh(pitch: float) -> Mesh:
    """A box along x, six times as long as thick; no edge is longer than the pitch."""
    box = trimesh.creation.box((6.0, 1.0, 1.0)).subdivide_to_size(pitch)
    return Mesh(box.vertices, box.faces, f"bar {pitch}")


def bent_bar(vertices: np.ndarray, angle: float = 1.5) -> np.ndarray:
    """An arc of so many radians: the axis keeps its length and sections stay plane."""
    length = np.ptp(vertices[:, 0])
    radius, turn = length / angle, vertices[:, 0] / length * angle
    across = radius - vertices[:, 2]
    return np.stack([across * np.sin(turn), vertices[:, 1], radius - across * np.cos(turn)], axis=1)

"""Shapes with answers that can be worked out by hand."""

from __future__ import annotations

import numpy as np
import trimesh

from ssm_pipeline.records import CorrespondedShapes, Mesh


def sphere(subdivisions: int, radius: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.icosphere(subdivisions, radius=radius)
    return np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64)


def speckles(points: np.ndarray, case_id: str) -> Mesh:
    """A mesh of one tiny equal triangle a point: P surface samples of it are just the points."""
    corners = 1e-4 * np.array([[1, 0, 0], [0, 1, 0], [-1, -1, 0]])
    vertices = (points[:, None] + corners).reshape(-1, 3)
    return Mesh(vertices, np.arange(len(vertices)).reshape(-1, 3), case_id)


def lattice(side: int = 5, spacing: float = 100.0) -> np.ndarray:
    """(side³, 3) points so far apart that each one's nearest neighbour is its own image."""
    line = (np.arange(side) - (side - 1) / 2) * spacing
    return np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)


def wavy_cohort(
    count: int, subdivisions: int = 2, modes: int = 4, seed: int = 0
) -> tuple[CorrespondedShapes, list[Mesh]]:
    """Ellipsoids with smooth random modes; the meshes are the corresponded shapes themselves."""
    generator = np.random.default_rng(seed)
    directions, faces = sphere(subdivisions)
    waves = np.cos(directions @ generator.normal(size=(3, modes)) + generator.uniform(0, 6, modes))
    amplitudes = generator.standard_normal((count, modes)) * np.linspace(6, 2, modes)
    shapes = directions * [40, 50, 70] + (amplitudes @ waves.T)[:, :, None] * directions
    ids = tuple(f"case_{index:02d}" for index in range(count))
    shapes += generator.normal(size=(count, 1, 3)) * 30
    return (
        CorrespondedShapes(shapes, faces, ids, ids[0]),
        [Mesh(vertices, faces, i) for vertices, i in zip(shapes, ids, strict=True)],
    )

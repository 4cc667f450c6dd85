"""Small made-up cohorts whose shapes correspond and whose modes are known."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation
from shapes import blob

from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records import CorrespondedShapes, Mesh

TURN = Similarity(
    1.0,
    Rotation.from_euler("xyz", [12, -8, 15], degrees=True).as_matrix(),
    np.array([40.0, -20.0, 300.0]),
)


def bumpy_cohort(count: int, seed: int = 0, rough_mm: float = 0.0) -> CorrespondedShapes:
    """Blobs of 100 mm that grow along z, bend, and bulge on one side: three smooth modes.

    rough_mm  standard deviation of a wave of its own on every case, which no mode explains.
    """
    generator = np.random.default_rng(seed)
    mesh = blob(1)
    points = mesh.vertices
    x, z = points[:, 0] / 30, points[:, 2] / 50
    out = points / np.linalg.norm(points, axis=1, keepdims=True)
    grow = np.stack([0 * z, 0 * z, 6 * z], axis=1)
    bend = np.stack([5 * z**2, 0 * z, 0.05 * x], axis=1)
    bulge = 4 * np.exp(-((x - 1) ** 2) - (z - 0.3) ** 2)[:, None] * out
    modes = np.stack([grow, bend, bulge])
    shapes = points + np.einsum("nm,mvd->nvd", generator.standard_normal((count, 3)), modes)
    for shape in shapes:
        wave = np.sin(points @ (0.08 * generator.standard_normal(3)) + 6 * generator.random())
        shape += rough_mm * np.sqrt(2) * wave[:, None] * out
    ids = tuple(f"c{index}" for index in range(count))
    return CorrespondedShapes(shapes, mesh.faces, ids, "c0")


def surfaces_of(shapes: CorrespondedShapes) -> list[Mesh]:
    """Each case's surface with a vertex in the middle of every face: no vertex is the model's
    alone."""
    return [
        finer(Mesh(points, shapes.faces, case_id))
        for points, case_id in zip(shapes.vertices, shapes.case_ids, strict=True)
    ]


def finer(mesh: Mesh) -> Mesh:
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    corner = len(mesh.vertices) + np.arange(len(middle))
    split = [np.column_stack([mesh.faces[:, [i, (i + 1) % 3]], corner]) for i in range(3)]
    return Mesh(np.concatenate([mesh.vertices, middle]), np.concatenate(split), mesh.case_id)

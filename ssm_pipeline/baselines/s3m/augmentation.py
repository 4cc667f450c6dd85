"""S3M's augmentation: shapes turned about the z axis and shapes with Gaussian bumps."""

from __future__ import annotations

import dataclasses

import numpy as np
import trimesh

from ssm_pipeline.geometry.surface import area
from ssm_pipeline.records import Mesh


def rotated_about_z(mesh: Mesh, angle: float) -> Mesh:
    """The mesh turned by `angle` (radians) about the z axis through its vertices' mean."""
    c, s = np.cos(angle), np.sin(angle)
    rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    centre = mesh.vertices.mean(axis=0)
    return dataclasses.replace(mesh, vertices=(mesh.vertices - centre) @ rotation.T + centre)


def bumped(
    mesh: Mesh, count: int, height: float, std: float, generator: np.random.Generator
) -> Mesh:
    """The mesh with `count` Gaussian bumps, in or out along the normals of the original.

    height and std (of the Gaussian) are shares of √area. The distance is the Euclidean one to the
    bump's vertex. Differs from the public code, which takes the difference of vertex *numbers*
    for the distance and cuts the bump off at its tenth ring.
    """
    size = np.sqrt(area(mesh.vertices, mesh.faces))
    normals = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).vertex_normals
    centres = mesh.vertices[generator.choice(len(mesh.vertices), count)]
    signs = generator.choice([-1.0, 1.0], count)
    squared = ((mesh.vertices[:, None] - centres) ** 2).sum(axis=2)
    offset = np.exp(-squared / (2 * (std * size) ** 2)) @ signs * height * size
    return dataclasses.replace(mesh, vertices=mesh.vertices + offset[:, None] * normals)

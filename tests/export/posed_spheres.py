"""A cohort with known poses: stretched spheres, each somewhere else in its scanner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records import CorrespondedShapes, Mesh
from ssm_pipeline.shape_model.alignment import align
from ssm_pipeline.shape_model.model import ShapeModel
from ssm_pipeline.shape_model.pca import pca_model


@dataclass(frozen=True)
class Spheres:
    shapes: CorrespondedShapes
    aligned: CorrespondedShapes
    frames: tuple[Similarity, ...]
    meshes: tuple[Mesh, ...]
    model: ShapeModel


def posed_spheres() -> Spheres:
    sphere = trimesh.creation.icosphere(subdivisions=2, radius=50.0)
    generator = np.random.default_rng(0)
    stretched = np.asarray(sphere.vertices) * (1 + 0.1 * generator.standard_normal((6, 1, 3)))
    poses = [
        Similarity(1.0, Rotation.from_rotvec(0.3 * turn).as_matrix(), 100 * shift)
        for turn, shift in zip(*generator.standard_normal((2, 6, 3)), strict=True)
    ]
    points = np.stack([pose.apply(shape) for pose, shape in zip(poses, stretched, strict=True)])
    ids = ("007", "008", "zoë", "a b", "1.3.6.1", "NA")  # what CSV readers like to change
    shapes = CorrespondedShapes(points, np.asarray(sphere.faces), ids, ids[0])
    aligned, frames = align(shapes, with_scale=True)
    meshes = tuple(Mesh(p[::-1], 161 - shapes.faces, i) for p, i in zip(points, ids, strict=True))
    return Spheres(shapes, aligned, frames, meshes, pca_model(aligned))

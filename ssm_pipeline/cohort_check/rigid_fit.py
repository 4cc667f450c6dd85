"""How well one mesh lies on another of unit area: as it is, turned, or mirrored."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ssm_pipeline.geometry.distances import SurfaceTarget
from ssm_pipeline.geometry.rigid import iterative_closest_point
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.geometry.surface import sample_points, unit_area_frame
from ssm_pipeline.records import Mesh

POINTS = 400  # on each surface
REFINED = 5  # of the starting rotations, the best are refined
FAR_DEG = 45.0  # turned further, a case does not lie as the others do
MIRROR = np.array([-1.0, 1.0, 1.0])


@dataclass(frozen=True, eq=False)
class Posed:
    """A mesh centred and scaled to unit area, with even points on it (P, 3)."""

    surface: SurfaceTarget
    points: np.ndarray

    @staticmethod
    def of(mesh: Mesh, seed: int) -> Posed:
        frame = unit_area_frame(mesh.vertices, mesh.faces)
        vertices = frame.inverse().apply(mesh.vertices)
        points = sample_points(vertices, mesh.faces, POINTS, np.random.default_rng(seed))
        return Posed(SurfaceTarget.of(vertices, mesh.faces), points)

    def mirrored(self) -> Posed:
        surface = SurfaceTarget.of(self.surface.vertices * MIRROR, self.surface.faces[:, ::-1])
        return Posed(surface, self.points * MIRROR)


def distance(source: Posed, target: Posed, pose: Similarity) -> float:
    """Mean of the directed mean distances, points to surface; the unit is √area."""
    there = target.surface.distances_to(pose.apply(source.points)).mean()
    back = source.surface.distances_to(pose.inverse().apply(target.points)).mean()
    return float(there + back) / 2


@dataclass(frozen=True)
class Fit:
    """The best pose of all rotations, its distance, and the best within FAR_DEG of as it lies."""

    pose: Similarity
    distance: float
    distance_near: float


def best_fit(source: Posed, target: Posed) -> Fit:
    """The rigid motion of source onto target, of any rotation: the principal axes laid on each
    other in all 24 ways and the pose as it lies are where it starts from."""
    tree = cKDTree(target.points)
    starts = [np.eye(3), *_axis_rotations(source.points, target.points)]
    errors = [tree.query(source.points @ start.T)[0].mean() for start in starts]
    # The pose as it lies is always refined: of an even body, all starts are alike.
    order = [0, *(int(index) for index in np.argsort(errors) if index != 0)]
    poses = [
        iterative_closest_point(
            source.points,
            target.points,
            Similarity(1.0, starts[index], np.zeros(3)),
            steps=10,
            tolerance=1e-3,
        )
        for index in order[:REFINED]
    ]
    best = min(poses, key=lambda pose: distance(source, target, pose))
    best = iterative_closest_point(source.points, target.points, best, steps=30, tolerance=1e-4)
    near = [
        distance(source, target, pose)
        for pose in (Similarity.identity(), *poses, best)
        if angle_deg(pose.rotation) <= FAR_DEG
    ]
    return Fit(best, distance(source, target, best), min(near))


def fit_to(mesh: Mesh, typical: Sequence[Mesh], seed: int) -> dict[str, float]:
    """Align a mesh with each of the typical ones except itself.

    Returns:
        Means over them: fit_percent, the distance at the best rotation, percent of √area;
        mirrored_percent, the same for the mirror image; near_percent, at the best rotation of up to
        FAR_DEG from how it lies; and turned_deg, the median angle of the best rotation, so that one
        odd fit does not count.
    """
    source = Posed.of(mesh, seed)
    image = source.mirrored()
    rows = []
    for other in typical:
        if other.case_id == mesh.case_id:
            continue
        target = Posed.of(other, seed)
        fit = best_fit(source, target)
        mirrored = best_fit(image, target).distance
        angle = angle_deg(fit.pose.rotation)
        rows.append((100 * fit.distance, 100 * mirrored, 100 * fit.distance_near, angle))
    means = np.mean(rows, axis=0)
    return {
        "fit_percent": float(means[0]),
        "mirrored_percent": float(means[1]),
        "near_percent": float(means[2]),
        "turned_deg": float(np.median([row[3] for row in rows])),
    }


def _axis_rotations(source: np.ndarray, target: np.ndarray) -> list[np.ndarray]:
    """The 24 rotations that lay principal axes on principal axes."""
    axes = [np.linalg.eigh(np.cov(points.T))[1] for points in (source, target)]
    rotations = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            rotation = axes[1] @ (np.eye(3)[list(order)] * signs) @ axes[0].T
            if np.linalg.det(rotation) > 0:
                rotations.append(rotation)
    return rotations


def angle_deg(rotation: np.ndarray) -> float:
    """The angle of a rotation (3, 3), degrees.

    >>> round(angle_deg(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])))
    90
    """
    return float(np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))))

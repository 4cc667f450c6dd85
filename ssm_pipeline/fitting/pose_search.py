"""How does this surface lie? Poses from which a fit can start, and mirror images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ssm_pipeline.fitting.partial import border_vertices
from ssm_pipeline.geometry.rigid import best_similarity
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.geometry.surface import sample_points
from ssm_pipeline.records import Mesh
from ssm_pipeline.shape_model.model import ShapeModel

POINTS = 300
COARSE_STEPS, FINE_STEPS = 12, 60
FINALISTS = 4
AWAY_DEG = 45.0  # poses that differ by less are the same one, found twice


@dataclass(frozen=True)
class StartPose:
    """frame: model → surface; error_mm: what is left between them, rigidly."""

    frame: Similarity
    error_mm: float


def turned_deg(frame: Similarity) -> float:
    """The angle of a frame's rotation, 0 … 180 degrees.

    >>> turned_deg(Similarity(1.0, np.diag([1.0, -1.0, -1.0]), np.zeros(3)))
    180.0
    """
    return float(np.degrees(Rotation.from_matrix(frame.rotation).magnitude()))


def mirrored(surface: Mesh) -> Mesh:
    """The surface reflected left to right, faces still outward."""
    return Mesh(surface.vertices * [-1.0, 1.0, 1.0], surface.faces[:, ::-1], surface.case_id)


def start_poses(
    model: ShapeModel, surface: Mesh, upright: np.ndarray | None = None, seed: int = 0
) -> tuple[StartPose, ...]:
    """Where the mean fits a surface rigidly: first how the model's cases lie, then the best pose
    of another orientation (more than 45 degrees away).

    upright (3, 3): the rotation, model → scanner, of how the cases lie; None: no rotation.

    Iterative closest points from each of the 24 turns that take a cube to itself; the best are
    refined. Of an open surface, every point must be near the model but not the other way about,
    and starts are shifted, too, towards where it is open: its middle is not the organ's.
    """
    generator = np.random.default_rng(seed)
    whole = sample_points(model.mean, model.faces, 4 * POINTS, generator)
    part = sample_points(surface.vertices, surface.faces, POINTS, generator)
    border = border_vertices(surface.faces, len(surface.vertices))
    shifts = np.zeros((1, 3))
    if border.any():
        # From the part's middle towards the cut, as far as the cut and half that.
        to_cut = surface.vertices[border].mean(axis=0) - part.mean(axis=0)
        shifts = np.array([[0.0], [0.5], [1.0]]) * to_cut
    search = _Search(whole, part, one_way=bool(border.any()))
    turns = Rotation.create_group("O").as_matrix()
    turns = turns[np.argsort(Rotation.from_matrix(turns).magnitude())]  # as the cases lie first
    turns = turns @ (np.eye(3) if upright is None else upright)
    coarse = [
        search.refined(search.started(turn, shift), COARSE_STEPS)
        for turn in turns
        for shift in shifts
    ]
    nearest = min(coarse[: len(shifts)], key=lambda pose: pose.error_mm)
    ranked = sorted(coarse, key=lambda pose: pose.error_mm)
    finalists = [search.refined(pose.frame, FINE_STEPS) for pose in ranked[:FINALISTS]]
    first = search.refined(nearest.frame, FINE_STEPS)
    others = [pose for pose in finalists if _between_deg(pose.frame, first.frame) > AWAY_DEG]
    best_other = min(others, key=lambda pose: pose.error_mm, default=None)
    return (first,) if best_other is None else (first, best_other)


class _Search:
    """Closest points between a model's points (S, 3) and a surface's (Q, 3)."""

    def __init__(self, whole: np.ndarray, part: np.ndarray, one_way: bool) -> None:
        self.whole, self.part, self.one_way = whole, part, one_way
        self.whole_tree, self.part_tree = cKDTree(whole), cKDTree(part)
        self.few = whole[:: len(whole) // len(part)]

    def started(self, turn: np.ndarray, shift: np.ndarray) -> Similarity:
        goal = self.part.mean(axis=0) + shift
        return Similarity(1.0, turn, goal - turn @ self.whole.mean(axis=0))

    def refined(self, frame: Similarity, steps: int) -> StartPose:
        """Rigid iterative closest points; one way, the surface's points to the model's only."""
        previous = np.inf
        for step in range(steps + 1):
            to_model, nearest = self.whole_tree.query(frame.inverse().apply(self.part))
            source, goals, errors = self.whole[nearest], self.part, to_model**2
            if not self.one_way:
                to_part, there = self.part_tree.query(frame.apply(self.few))
                source = np.concatenate([source, self.few])
                goals = np.concatenate([goals, self.part[there]])
                errors = np.concatenate([errors, to_part**2])
            error = float(np.sqrt(errors.mean()))
            if step == steps or previous - error < 1e-4 * error:
                break
            previous, frame = error, best_similarity(source, goals)
        return StartPose(frame, error)


def _between_deg(a: Similarity, b: Similarity) -> float:
    return float(np.degrees(Rotation.from_matrix(a.rotation.T @ b.rotation).magnitude()))

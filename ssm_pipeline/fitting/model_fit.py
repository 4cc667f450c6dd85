"""The model laid on a surface: the most probable pose and scores, and what is left open.

Posterior by regularised least squares: every observed point pulls with the precision of the noise,
the scores are held by their prior, the pose is free.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ssm_pipeline.fitting.observations import independent_observations
from ssm_pipeline.fitting.partial import border_vertices, lies_on_border
from ssm_pipeline.geometry.barycentric import interpolated
from ssm_pipeline.geometry.closest_point import ClosestPoints, closest_points
from ssm_pipeline.geometry.distances import SurfaceTarget
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.geometry.surface import area, face_normals, sample_surface, vertex_normals
from ssm_pipeline.records import CaseError, Mesh
from ssm_pipeline.shape_model.model import ShapeModel

TANGENTIAL = 0.05  # weight of sliding along the surface against the normal's 1
OUTLIER = 3.0  # residuals of so many standard deviations pull half as much as they would
OPPOSED = -0.2  # cosine of the two normals under which a nearest point is of another side
CORRELATION_POINTS = 300


@dataclass(frozen=True, eq=False)
class Fit:
    """A model on a surface.

    scores (M,) standard deviations, covariance (M, M): their posterior.
    vertices (V, 3) mm: the most probable shape, in the surface's own space; frame: model → there.
    observed (V,) bool: the vertices whose part of the surface was there to be seen.
    distances_mm (V,): from every vertex to the surface, in its own millimetres.
    noise_mm: standard deviation of a point about the fitted surface, along its normal, in the
    model's millimetres; observations: how many independent points the surface was worth.
    """

    scores: np.ndarray
    covariance: np.ndarray
    vertices: np.ndarray
    frame: Similarity
    observed: np.ndarray
    distances_mm: np.ndarray
    noise_mm: float
    observations: float

    @property
    def score_sd(self) -> np.ndarray:
        """(M,) standard deviation of each score, in the model's standard deviations."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def mahalanobis(self) -> float:
        """Distance from the mean, in standard deviations: √Σ scores²."""
        return float(np.linalg.norm(self.scores))

    @property
    def residual_mm(self) -> float:
        """Mean distance of the observed vertices from the surface."""
        return float(self.distances_mm[self.observed].mean())

    @property
    def is_partial(self) -> bool:
        return not bool(self.observed.all())


def fit_model(
    model: ShapeModel,
    surface: Mesh,
    start: Similarity | None = None,
    with_scale: bool = False,
    points: int = 1000,
    steps: int = 60,
    seed: int = 0,
) -> Fit:
    """The most probable instance of the model on a surface, and its pose.

    Alternates: nearest points both ways, noise and its correlation from what is left between them,
    and one Gauss–Newton step on scores and pose together.

    Args:
        surface: In millimetres; open where it was cut off: what lies beyond a border is not held
            against the model.
        start: Model → surface, to about 30 degrees; None: centre on centre, as the cases lie.
            `pose_search` finds others.
        with_scale: The pose has a size, as in a model without one.
        points: On either surface that are brought to the other.

    Raises:
        CaseError: Where no point of the model faces the surface.

    Source: Cootes 1995 (active shape models); Albrecht et al. 2013 for the posterior; Chen and
    Medioni 1991 for the distance along normals.

    >>> import trimesh
    >>> ball = trimesh.creation.icosphere(3, radius=40)
    >>> wider = np.asarray(ball.vertices) * [1, 0, 0] / np.linalg.norm(ball.vertices[:, 0])
    >>> model = ShapeModel(
    ...     mean=ball.vertices, modes=wider[None], variances=np.array([50.0**2]), faces=ball.faces,
    ...     scores=np.zeros((0, 1)), case_ids=(),
    ... )
    >>> seen = Mesh(model.reconstruct([1.5]) + 200, ball.faces, "elsewhere")
    >>> np.round(fit_model(model, seen).scores, 1)
    array([1.5])
    """
    problem = _Problem(model, surface, with_scale, points, np.random.default_rng(seed))
    frame = start or Similarity(1.0, np.eye(3), surface.vertices.mean(0) - model.mean.mean(0))
    scores = np.zeros(model.mode_count)
    noise, observations = np.inf, float(points) / 10
    covariance = np.eye(model.mode_count)
    for step in range(steps):
        pairs = problem.pairs(frame, scores)
        noise = pairs.spread() * (2 if step < 5 else 1)  # cautious while the pose is rough
        if step >= 5:
            observations = pairs.independent(problem.size * pairs.observed_share)
        new, covariance, change = problem.solve(pairs, frame, scores, noise, observations)
        moved = change.apply(model.reconstruct(new)) - model.reconstruct(scores)
        scores, frame = new, _composed(frame, change)
        if step > 10 and np.abs(moved).max() < 0.02 * noise:
            break
    vertices = frame.apply(model.reconstruct(scores))
    return Fit(
        scores,
        covariance,
        vertices,
        frame,
        *problem.seen(vertices),
        noise_mm=noise,
        observations=observations,
    )


def surface_variance(model: ShapeModel, fitted: Fit) -> np.ndarray:
    """(V,) mm², in the surface's own: how far the surface may lie from each fitted vertex along its
    normal. What the posterior of the scores leaves open, and the noise of what no mode can make."""
    normals = vertex_normals(model.reconstruct(fitted.scores), model.faces)
    along = np.einsum("mvd,vd->vm", model.modes, normals) * model.standard_deviations
    left_open = np.einsum("vm,mn,vn->v", along, fitted.covariance, along)
    result: np.ndarray = fitted.frame.scale**2 * (left_open + fitted.noise_mm**2)
    return result


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Points of the model with where they should be, all in the model's frame.

    corners (K, 3) int, weights (K, 3): the model's points; at (K, 3) mm: where they are;
    goals (K, 3) mm, normals (K, 3): the nearest tangent planes; of_model: how many of the
    observed pairs started from the model; observed_share: of those that might have been.
    """

    corners: np.ndarray
    weights: np.ndarray
    at: np.ndarray
    goals: np.ndarray
    normals: np.ndarray
    of_model: int
    observed_share: float

    @property
    def residuals(self) -> np.ndarray:
        """(K,) mm along the normals."""
        result: np.ndarray = np.einsum("kd,kd->k", self.normals, self.goals - self.at)
        return result

    def spread(self) -> float:
        """Robust standard deviation of the residuals, mm."""
        absolute = np.abs(self.residuals)
        rough = 1.4826 * float(np.median(absolute)) + 1e-9
        weights = _robust(absolute, rough)
        return float(np.sqrt((weights * absolute**2).sum() / weights.sum())) + 1e-9

    def independent(self, observed_area: float) -> float:
        step = max(1, self.of_model // CORRELATION_POINTS)
        chosen = slice(0, self.of_model, step)
        return independent_observations(self.at[chosen], self.residuals[chosen], observed_area)


class _Problem:
    """A model and a surface, with the points that are compared."""

    def __init__(
        self,
        model: ShapeModel,
        surface: Mesh,
        with_scale: bool,
        points: int,
        generator: np.random.Generator,
    ) -> None:
        self.model, self.surface, self.with_scale = model, surface, with_scale
        face, self.weights = sample_surface(model.mean, model.faces, points, generator)
        self.corners = model.faces[face]
        self.target = SurfaceTarget.of(surface.vertices, surface.faces)
        face, weights = sample_surface(surface.vertices, surface.faces, points, generator)
        self.on_surface = interpolated(surface.vertices, surface.faces[face], weights)
        self.border = border_vertices(surface.faces, len(surface.vertices))
        self.normals = face_normals(surface.vertices, surface.faces)
        self.normals_there = self.normals[face]
        self.size = area(model.mean, model.faces)
        # (V, 3, M): millimetres that a vertex moves per standard deviation of each score.
        spread = model.modes * model.standard_deviations[:, None, None]
        self.spread = np.ascontiguousarray(np.moveaxis(spread, 0, 2))

    def nearest(self, points: np.ndarray) -> ClosestPoints:
        return closest_points(points, self.target.vertices, self.target.faces, self.target.tree)

    def pairs(self, frame: Similarity, scores: np.ndarray) -> _Pairs:
        """Nearest points of the model's samples on the surface, and of the surface's on it."""
        instance = self.model.reconstruct(scores)
        own = vertex_normals(instance, self.model.faces) @ frame.rotation.T
        posed = frame.apply(instance)
        there = interpolated(posed, self.corners, self.weights)
        found = self.nearest(there)
        facing = np.einsum("kd,kd->k", self.normals[found.faces], own[self.corners[:, 0]])
        seen = ~lies_on_border(found, self.surface.faces, self.border) & (facing > OPPOSED)

        back = closest_points(self.on_surface, posed, self.model.faces)
        corners = self.model.faces[back.faces]
        same = np.einsum("kd,kd->k", self.normals_there, own[corners[:, 0]]) > OPPOSED

        if not seen.any():
            raise CaseError(
                self.surface.case_id,
                "no point of the model faces the surface. Its triangles look inward, or it lies "
                "elsewhere: turn the triangles around, or give a start.",
            )
        inverse = frame.inverse()
        all_corners = np.concatenate([self.corners[seen], corners[same]])
        all_weights = np.concatenate([self.weights[seen], back.barycentric[same]])
        goals = np.concatenate([found.points[seen], self.on_surface[same]])
        planes = np.concatenate([self.normals[found.faces][seen], self.normals_there[same]])
        return _Pairs(
            corners=all_corners,
            weights=all_weights,
            at=interpolated(instance, all_corners, all_weights),
            goals=inverse.apply(goals),
            normals=planes @ frame.rotation,
            of_model=int(seen.sum()),
            observed_share=float(seen.mean()),
        )

    def solve(
        self,
        pairs: _Pairs,
        frame: Similarity,
        scores: np.ndarray,
        noise: float,
        observations: float,
    ) -> tuple[np.ndarray, np.ndarray, Similarity]:
        """New scores, their covariance, and the change of pose, in the model's frame."""
        modes = np.einsum("kc,kcdm->kdm", pairs.weights, self.spread[pairs.corners])
        centre = self.model.mean.mean(axis=0)
        arm = pairs.at - centre
        turn = np.stack([np.cross(axis, arm) for axis in np.eye(3)], axis=2)  # (K, 3, 3)
        shift = np.broadcast_to(np.eye(3), turn.shape)
        parts = [modes, turn, shift] + ([arm[:, :, None]] if self.with_scale else [])
        A = np.concatenate(parts, axis=2)  # (K, 3, M + pose)
        goal = pairs.goals - pairs.at + modes @ scores
        along = np.einsum("kd,kdp->kp", pairs.normals, A)
        along_goal = np.einsum("kd,kd->k", pairs.normals, goal)
        weight = _robust(np.abs(pairs.residuals), noise)
        weight *= observations / len(weight) / noise**2
        normal_part = along.T @ (weight[:, None] * along)
        flat = A.reshape(-1, A.shape[2])
        each = np.repeat(weight, 3)
        precision = (1 - TANGENTIAL) * normal_part + TANGENTIAL * flat.T @ (each[:, None] * flat)
        right = (1 - TANGENTIAL) * along.T @ (weight * along_goal)
        right += TANGENTIAL * flat.T @ (each * goal.ravel())
        count = self.model.mode_count
        precision[np.arange(count), np.arange(count)] += 1
        solved = np.linalg.solve(precision, right)
        pose = solved[count:]
        rotation = Rotation.from_rotvec(pose[:3]).as_matrix()
        scale = float(np.exp(np.clip(pose[6], -0.3, 0.3))) if self.with_scale else 1.0
        change = Similarity(scale, rotation, centre + pose[3:6] - scale * rotation @ centre)
        return solved[:count], np.linalg.inv(precision)[:count, :count], change

    def seen(self, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """observed (V,) and distances_mm (V,) of the model's vertices in the surface's space."""
        found = self.nearest(vertices)
        observed = ~lies_on_border(found, self.surface.faces, self.border)
        return observed, found.distances


def _robust(absolute: np.ndarray, noise: float) -> np.ndarray:
    """(K,) weights of Cauchy's estimator."""
    return 1 / (1 + (absolute / (OUTLIER * noise)) ** 2)


def _composed(outer: Similarity, inner: Similarity) -> Similarity:
    return Similarity(
        outer.scale * inner.scale, outer.rotation @ inner.rotation, outer.apply(inner.translation)
    )

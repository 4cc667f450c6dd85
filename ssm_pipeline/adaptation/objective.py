"""What adaptation minimises: CD(X + Δ, Y) + stiffness · trace(ΔᵀLΔ), and a pull to the map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from pykdtree.kdtree import KDTree

from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.geometry.barycentric import interpolated
from ssm_pipeline.geometry.surface import face_normals, sample_surface


@dataclass(frozen=True, eq=False)
class Triangles:
    """A surface at unit area: vertices (V, 3), faces (F, 3)."""

    vertices: np.ndarray
    faces: np.ndarray


@dataclass(frozen=True, eq=False)
class Nearest:
    """The nearest samples both ways: of Y for each of X (S,), of X for each of Y (S,), with
    squared distances."""

    y_of_x: np.ndarray
    x_of_y: np.ndarray
    squared_x: np.ndarray
    squared_y: np.ndarray

    @property
    def chamfer(self) -> float:
        """Symmetric, squared: the sum of the two directed means."""
        return float(self.squared_x.mean() + self.squared_y.mean())


@dataclass(frozen=True, eq=False)
class MapPull:
    """Where a map says each vertex goes: Σ_i w_i ‖x_i + Δ_i − points_i‖².

    points (V, 3) unit area: (Π_xy Y)_i; weights (V,) w_i = μ A_i c_i: area times confidence.
    """

    points: np.ndarray
    weights: np.ndarray


class AdaptationObjective:
    """Fixed even samples on both surfaces; those of X move with its vertices.

    x the surface to be moved; laplacian (V, V) sparse: its template's; y the one it is moved to.
    """

    def __init__(
        self,
        x: Triangles,
        laplacian: sp.csr_matrix,
        y: Triangles,
        settings: AdaptationSettings,
        generator: np.random.Generator,
        pull: MapPull | None = None,
    ) -> None:
        self.vertices, self.faces, self.pull = x.vertices, x.faces, pull
        self.laplacian, self.stiffness = laplacian, settings.stiffness
        self.face, self.weights = sample_surface(x.vertices, x.faces, settings.samples, generator)
        target_face, target_weights = sample_surface(
            y.vertices, y.faces, settings.samples, generator
        )
        self.target = interpolated(y.vertices, y.faces[target_face], target_weights)
        normals = face_normals(y.vertices, y.faces)[target_face]
        self.target_normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        self.target_tree = KDTree(self.target)

    def moved_samples(self, offsets: np.ndarray) -> np.ndarray:
        """(S, 3) samples of X + Δ."""
        return interpolated(self.vertices + offsets, self.faces[self.face], self.weights)

    def nearest(self, samples: np.ndarray) -> Nearest:
        distance_x, y_of_x = self.target_tree.query(samples)
        distance_y, x_of_y = KDTree(samples).query(self.target)
        return Nearest(
            y_of_x.astype(np.int64), x_of_y.astype(np.int64), distance_x**2, distance_y**2
        )

    def value(self, offsets: np.ndarray, nearest: Nearest | None = None) -> float:
        nearest = nearest or self.nearest(self.moved_samples(offsets))
        smooth = nearest.chamfer + self.stiffness * self.dirichlet(offsets)
        if self.pull is None:
            return smooth
        gap = self.vertices + offsets - self.pull.points
        return smooth + float(self.pull.weights @ (gap**2).sum(axis=1))

    def dirichlet(self, offsets: np.ndarray) -> float:
        """trace(ΔᵀLΔ)."""
        return float((offsets * (self.laplacian @ offsets)).sum())

    def gradient(self, offsets: np.ndarray) -> np.ndarray:
        """(V, 3): with the nearest neighbours held, which is the gradient where they are unique."""
        samples = self.moved_samples(offsets)
        near = self.nearest(samples)
        pull = 2 * (samples - self.target[near.y_of_x]) / len(samples)
        back = 2 * (samples[near.x_of_y] - self.target) / len(samples)
        for d in range(3):
            pull[:, d] += np.bincount(near.x_of_y, back[:, d], len(samples))
        corners = self.faces[self.face].ravel()
        spread = (self.weights[:, :, None] * pull[:, None, :]).reshape(-1, 3)
        total = 2 * self.stiffness * (self.laplacian @ offsets)
        if self.pull is not None:
            gap = self.vertices + offsets - self.pull.points
            total += 2 * self.pull.weights[:, None] * gap
        for d in range(3):
            total[:, d] += np.bincount(corners, spread[:, d], len(self.vertices))
        result: np.ndarray = total
        return result

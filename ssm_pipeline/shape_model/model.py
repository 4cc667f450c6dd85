"""The point distribution model: a mean shape and its modes of variation, immutable."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ssm_pipeline.records import Mesh
from ssm_pipeline.shape_model.fitting import fit


@dataclass(frozen=True)
class ShapeModel:
    """x = mean + Σ_m scores_m √variance_m mode_m, in millimetres (Cootes 1995).

    mean       (V, 3) mm LPS; faces (F, 3) int.
    modes      (M, V, 3), orthonormal as vectors of 3V numbers.
    variances  (M,) mm², divisor N − 1, descending.
    scores     (N, M) the training cases in standard deviations; case_ids (N,).
    """

    mean: np.ndarray
    modes: np.ndarray
    variances: np.ndarray
    faces: np.ndarray
    scores: np.ndarray
    case_ids: tuple[str, ...]

    def __post_init__(self) -> None:
        if self.modes.shape[1:] != self.mean.shape or len(self.modes) != len(self.variances):
            raise ValueError(
                f"modes have shape {self.modes.shape} for a mean of shape {self.mean.shape} and "
                f"{len(self.variances)} variances; (M, V, 3), (V, 3) and (M,) are needed"
            )

    @property
    def mode_count(self) -> int:
        return len(self.variances)

    @property
    def standard_deviations(self) -> np.ndarray:
        """(M,) mm."""
        return np.sqrt(self.variances)

    @property
    def compactness(self) -> np.ndarray:
        """(M,) share of the total variance in the first m modes (Davies 2002)."""
        return np.cumsum(self.variances) / self.variances.sum()

    def modes_for(self, share: float) -> int:
        """The smallest number of modes that holds `share` (0 … 1) of the variance."""
        return int(np.searchsorted(self.compactness, share - 1e-12) + 1)

    def reconstruct(self, scores: np.ndarray) -> np.ndarray:
        """Shapes from scores: (…, m) standard deviations, m ≤ M → (…, V, 3) mm."""
        scores = np.asarray(scores, dtype=np.float64)
        count = scores.shape[-1]
        if count > self.mode_count:
            raise ValueError(f"{count} scores given; the model has {self.mode_count} modes")
        weights = scores * self.standard_deviations[:count]
        return self.mean + np.tensordot(weights, self.modes[:count], axes=1)

    def project(self, shape: np.ndarray | Mesh) -> np.ndarray:
        """Scores of a shape, (…, M) standard deviations.

        shape  corresponding, aligned points (…, V, 3) mm, projected exactly; or any mesh of the
               organ in millimetres, to which the model is fitted first
               (`ssm_pipeline.shape_model.fitting.fit`, which also gives pose and distances).
        """
        if isinstance(shape, Mesh):
            return fit(self, shape).scores
        points = np.asarray(shape, dtype=np.float64)
        if points.shape[-2:] != self.mean.shape:
            raise ValueError(
                f"points have shape {points.shape}; (…, {len(self.mean)}, 3) is needed, in "
                "correspondence with the model's mean"
            )
        flat = (points - self.mean).reshape(*points.shape[:-2], -1)
        return flat @ self.modes.reshape(self.mode_count, -1).T / self.standard_deviations

    def sample(self, count: int, generator: np.random.Generator) -> np.ndarray:
        """(count, V, 3) mm: independent draws from the model's normal distribution."""
        return self.reconstruct(generator.standard_normal((count, self.mode_count)))

    def truncate(self, mode_count: int) -> ShapeModel:
        """The model of the first modes only. Raises ValueError outside 1 … M."""
        if not 1 <= mode_count <= self.mode_count:
            raise ValueError(f"{mode_count} modes asked of a model with {self.mode_count}")
        return ShapeModel(
            self.mean,
            self.modes[:mode_count],
            self.variances[:mode_count],
            self.faces,
            self.scores[:, :mode_count],
            self.case_ids,
        )

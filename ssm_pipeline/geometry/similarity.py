"""Similarity transforms: a turn, an even scaling and a shift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Similarity:
    """outer = scale · R · inner + t: from unit area to millimetres, or from a case to the model.

    rotation (3, 3), determinant +1; translation (3,). A rigid motion has scale 1.

    >>> twice = Similarity(2.0, np.eye(3), np.array([0.0, 0.0, 5.0]))
    >>> twice.apply(np.array([1.0, 2.0, 3.0]))
    array([ 2.,  4., 11.])
    >>> twice.inverse().apply(np.array([2.0, 4.0, 11.0]))
    array([1., 2., 3.])
    """

    scale: float
    rotation: np.ndarray
    translation: np.ndarray

    @staticmethod
    def identity() -> Similarity:
        return Similarity(1.0, np.eye(3), np.zeros(3))

    def apply(self, points: np.ndarray) -> np.ndarray:
        """(…, 3) → (…, 3)."""
        result: np.ndarray = self.scale * points @ self.rotation.T + self.translation
        return result

    def inverse(self) -> Similarity:
        rotation = self.rotation.T
        return Similarity(1 / self.scale, rotation, -(rotation @ self.translation) / self.scale)

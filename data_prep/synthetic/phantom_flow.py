"""Deformations that cannot fold: flows of smooth velocity fields, and random ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

Velocity = Callable[[np.ndarray], np.ndarray]  # (V, 3) mm → (V, 3) mm per unit of time


@dataclass(frozen=True)
class Push:
    """A velocity of one direction that fades from a centre: push · exp(−½ Σ ((x − c) / w)²).

    centre, widths (of the Gaussian along x, y, z) and push: (3,) mm.
    """

    centre: tuple[float, float, float]
    widths: tuple[float, float, float]
    push: tuple[float, float, float]

    def __call__(self, points: np.ndarray) -> np.ndarray:
        result: np.ndarray = _gaussian(points, self.centre, self.widths)[:, None] * np.array(
            self.push
        )
        return result


@dataclass(frozen=True)
class Swell:
    """A velocity away from a centre that fades: rate · (x − c) · exp(−½ Σ ((x − c) / w)²)."""

    centre: tuple[float, float, float]
    widths: tuple[float, float, float]
    rate: float

    def __call__(self, points: np.ndarray) -> np.ndarray:
        away = self.rate * (points - np.array(self.centre))
        result: np.ndarray = _gaussian(points, self.centre, self.widths)[:, None] * away
        return result


@dataclass(frozen=True)
class Combination:
    """Σ weight · velocity."""

    weights: tuple[float, ...]
    velocities: tuple[Velocity, ...]

    def __call__(self, points: np.ndarray) -> np.ndarray:
        total = np.zeros_like(points)
        for weight, velocity in zip(self.weights, self.velocities, strict=True):
            total += weight * velocity(points)
        return total


def flow(points: np.ndarray, velocity: Velocity, steps: int = 8) -> np.ndarray:
    """Where points (V, 3) mm are after one unit of time in a steady velocity field.

    The flow of a smooth field is a diffeomorphism, whatever its size: no surface carried by it can
    fold or meet itself, and the flow of −velocity undoes it. Fourth-order Runge-Kutta.

    >>> away = flow(np.array([[1.0, 0, 0]]), lambda x: x)
    >>> bool(abs(away[0, 0] - np.e) < 1e-5)
    True
    """
    h = 1 / steps
    for _ in range(steps):
        k1 = velocity(points)
        k2 = velocity(points + h / 2 * k1)
        k3 = velocity(points + h / 2 * k2)
        k4 = velocity(points + h * k3)
        points = points + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return points


@dataclass(frozen=True, eq=False)
class Bumps:
    """Σ push_k · exp(−½ |x − c_k|² / w_k²): centres and pushes (K, 3) mm, widths (K,) mm."""

    centres: np.ndarray
    widths: np.ndarray
    pushes: np.ndarray

    def __call__(self, points: np.ndarray) -> np.ndarray:
        middle = self.centres.mean(axis=0)  # near it, the squares' difference keeps its digits
        x, c = points - middle, self.centres - middle
        squared = (x**2).sum(axis=1)[:, None] + (c**2).sum(axis=1) - 2 * x @ c.T
        result: np.ndarray = np.exp(-0.5 * squared / self.widths**2) @ self.pushes
        return result


def random_velocity(
    surface: np.ndarray,
    rms_mm: float,
    widths_mm: Sequence[float],
    generator: np.random.Generator,
    bumps: int = 60,
) -> Bumps:
    """A smooth random velocity near a surface (V, 3) mm: Gaussian bumps at random points of it.

    Args:
        widths_mm: Of the bumps' Gaussians: so many bumps of each, pushing the more the wider they
            are.
        rms_mm: Root mean square of the velocity over the surface's points.
    """
    widths = np.repeat(np.asarray(widths_mm, float), bumps)
    centres = surface[generator.integers(len(surface), size=len(widths))]
    raw = Bumps(centres, widths, widths[:, None] * generator.standard_normal((len(widths), 3)))
    size = np.sqrt((raw(surface) ** 2).sum(axis=1).mean())
    return Bumps(centres, widths, raw.pushes * (rms_mm / size))


def _gaussian(points: np.ndarray, centre: Sequence[float], widths: Sequence[float]) -> np.ndarray:
    result: np.ndarray = np.exp(
        -0.5 * (((points - np.array(centre)) / np.array(widths)) ** 2).sum(axis=1)
    )
    return result

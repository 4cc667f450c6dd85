"""Organ-like shapes of no anatomy: as many families as wanted, the cases of each varied at random.

What a network learns from one anatomy it recognises that anatomy by; many that have little in
common teach what holds for all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from ssm_pipeline.data_prep.synthetic.phantom_family import level_surface, smooth_maximum
from ssm_pipeline.data_prep.synthetic.phantom_flow import flow, random_velocity
from ssm_pipeline.geometry.topology import is_oriented_manifold

_REACH_MM = 130.0  # half the box that a mean is drawn in
_BLEND_MM = 6.0  # edges are rounded at about this radius
# What varies, in shares of the shape's size (the root mean square distance from its centre): root
# mean square and widths of a random flow, from lobes to dents.
_FLOWS = ((0.14, (0.6, 0.35)), (0.03, (0.16, 0.1)))
_STRETCH = 0.08  # standard deviation of each number of an affine map


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """centre and radii: (3,) mm; axes: of the radii."""

    centre: np.ndarray
    radii: np.ndarray
    axes: Rotation

    def outside_mm(self, points: np.ndarray) -> np.ndarray:
        """(Q,) about the signed distance of points (Q, 3), negative inside."""
        local = self.axes.apply(points - self.centre, inverse=True) / self.radii
        result: np.ndarray = (np.linalg.norm(local, axis=1) - 1) * self.radii.min()
        return result


def random_family(
    generator: np.random.Generator, cases: int
) -> tuple[list[np.ndarray], np.ndarray]:
    """Corresponding vertices (V, 3) mm of each case, and their faces (F, 3)."""
    mean, faces = random_organ(generator)
    return [varied(mean, generator) for _ in range(cases)], faces


def random_organ(generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) mm and faces (F, 3): two to five ellipsoids in one, up to three taken away.

    One closed piece of some thousand vertices, 100 to 200 mm long, with ridges, hollows and lobes.
    """
    while True:
        added = _ellipsoids(generator, int(generator.integers(2, 6)), 40.0, (18.0, 55.0))
        taken = _ellipsoids(generator, int(generator.integers(4)), 80.0, (20.0, 60.0))
        try:
            vertices, faces = _surface(added, taken)
        except ValueError:  # nothing is left of it
            continue
        pieces = trimesh.Trimesh(vertices, faces, process=False).body_count
        if pieces == 1 and len(vertices) > 1500 and is_oriented_manifold(faces):
            return vertices, faces


def varied(mean: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """(V, 3) mm: the shape stretched, and carried by random flows, so that it cannot fold."""
    centre = mean.mean(axis=0)
    stretch = np.eye(3) + _STRETCH * generator.standard_normal((3, 3))
    points = (mean - centre) @ stretch.T
    size = np.sqrt((points**2).sum(axis=1).mean())
    for share, widths in _FLOWS:
        velocity = random_velocity(points, share * size, size * np.array(widths), generator)
        points = flow(points, velocity)
    result: np.ndarray = points + centre
    return result


def _surface(
    added: Sequence[Ellipsoid], taken: Sequence[Ellipsoid]
) -> tuple[np.ndarray, np.ndarray]:
    def outside_mm(points: np.ndarray) -> np.ndarray:
        solid = smooth_maximum(np.stack([body.outside_mm(points) for body in added]), -_BLEND_MM)
        hollows = [-body.outside_mm(points) for body in taken]
        return smooth_maximum(np.stack([solid, *hollows]), _BLEND_MM)

    low, high = (-_REACH_MM,) * 3, (_REACH_MM,) * 3
    return level_surface(outside_mm, low, high, step_mm=5.0, edge_mm=4.0)


def _ellipsoids(
    generator: np.random.Generator, count: int, reach_mm: float, radii_mm: tuple[float, float]
) -> list[Ellipsoid]:
    """Centres about `reach_mm` from the origin."""
    return [
        Ellipsoid(
            reach_mm * generator.standard_normal(3) / np.sqrt(3),
            generator.uniform(*radii_mm, size=3),
            Rotation.random(rng=generator),
        )
        for _ in range(count)
    ]

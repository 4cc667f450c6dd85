"""A left lung as an atlas draws it, built by taking its neighbours away from the chest.

LPS in mm: +x lateral, +y posterior, +z towards the apex. The chest less the mediastinum, the heart,
the aorta with its arch, the spine and the diaphragm leaves thin edges and hollows: the surface is
not star-shaped. Its modes are local, as lungs differ; little of what varies is affine.
"""

from __future__ import annotations

import itertools
from functools import cache

import numpy as np

from ssm_pipeline.data_prep.synthetic.phantom_family import (
    PhantomFamily,
    level_surface,
    smooth_maximum,
)
from ssm_pipeline.data_prep.synthetic.phantom_flow import Push, Swell, Velocity

CENTRE = np.array([78.0, 10.0, 0.0])  # mm, where the lung's own origin lies in the patient
_BLEND_MM = 3.0
_HILUM = np.array([-36.0, 12.0, 8.0])
# Arch and descending aorta, from front to back over the hilum and down along the spine.
_AORTA = np.array(
    [
        (-52.0, -22, 30),
        (-46, -8, 46),
        (-43, 14, 54),
        (-45, 34, 46),
        (-47, 44, 26),
        (-48, 48, -10),
        (-49, 49, -50),
        (-50, 48, -95),
        (-51, 46, -150),
    ]
)


@cache
def lung_family() -> PhantomFamily:
    """The mean left lung of about 2.5 l in 10 000 vertices, two lobes, and its scans."""
    vertices, faces = level_surface(
        _outside_mm, (-95.0, -110.0, -165.0), (80.0, 110.0, 150.0), step_mm=3.0, edge_mm=4.2
    )
    near_hilum = np.linalg.norm(vertices - _HILUM, axis=1) < 24
    # The oblique fissure, from high at the back to low at the front.
    fissure = 55 + 1.15 * (vertices[:, 1] - 75) - vertices[:, 2]
    return PhantomFamily(
        organ="lung",
        vertices=vertices + CENTRE,
        faces=faces,
        modes=tuple(_Shifted(mode) for mode in _MODES),
        border=fissure,
        pivot=CENTRE * [0, 1, 1],
        residual_mm=4.0,
        residual_widths_mm=(30.0, 16.0),
        in_plane_mm=(0.9, 1.3),
        slice_mm=(1.25, 3.0),
        hilum=np.flatnonzero(near_hilum),
        bridge_mm=3.5,
        bridge_share=0.3,
        cut_share=0.15,
    )


class _Shifted:
    """A velocity given about the lung's own origin, in the patient's space."""

    def __init__(self, velocity: Velocity) -> None:
        self.velocity = velocity

    def __call__(self, points: np.ndarray) -> np.ndarray:
        return self.velocity(points - CENTRE)


def _growth(points: np.ndarray) -> np.ndarray:
    """Larger or smaller as a whole, the taller the more: the affine part of what varies."""
    return points * [0.008, 0.008, 0.013]


_MODES: tuple[Velocity, ...] = (
    _growth,
    Push((-15.0, -50.0, -55.0), (34.0, 34.0, 40.0), (14.0, 10.0, 2.0)),  # depth of cardiac notch
    Push((-10.0, 0.0, -85.0), (38.0, 42.0, 34.0), (0.0, 0.0, 13.0)),  # curvature of the base
    Push((8.0, 70.0, -125.0), (48.0, 34.0, 30.0), (0.0, 3.0, -13.0)),  # costophrenic edge, behind
    Push((48.0, -10.0, -115.0), (26.0, 48.0, 30.0), (2.0, 0.0, -11.0)),  # and at the side
    Push((-35.0, 8.0, 125.0), (36.0, 36.0, 34.0), (-7.0, 10.0, 5.0)),  # lean of the apex
    Swell((-30.0, 8.0, 105.0), (40.0, 40.0, 34.0), 0.22),  # a wide or a pointed apex
    Push((-45.0, -75.0, 25.0), (30.0, 30.0, 48.0), (-13.0, -3.0, 0.0)),  # anterior edge
    Push((-5.0, -80.0, -95.0), (34.0, 28.0, 28.0), (-6.0, -8.0, -10.0)),  # lingula
    Push((-45.0, 45.0, -30.0), (24.0, 20.0, 75.0), (9.0, 4.0, 0.0)),  # how deep the aorta lies
    Push((50.0, 20.0, 10.0), (26.0, 55.0, 55.0), (9.0, 0.0, 0.0)),  # bulge of the ribs
)


def _outside_mm(points: np.ndarray) -> np.ndarray:
    """(Q,) about the distance outside the mean lung, about its own origin; negative inside."""
    x, y, z = points.T

    def ball(centre: tuple[float, float, float], radii: tuple[float, float, float]) -> np.ndarray:
        scaled = np.linalg.norm((points - np.array(centre)) / np.array(radii), axis=1)
        result: np.ndarray = (1 - scaled) * min(radii)
        return result

    up, down = np.clip(z, 0, None), np.clip(-z, 0, None)
    wide = (90 + 0.03 * down) * (1 - 0.3 * (up / 136) ** 1.6)
    chest = np.stack([(x + 38) / wide, (y - 4 - 0.1 * up) / (wide + 3), up / 138])
    chest_wall = ((np.abs(chest) ** 2.25).sum(axis=0) ** (1 / 2.25) - 1) * 85
    # The ribs run forward and down, and press in along the chest wall alone.
    ribs = 0.8 * np.sin(2 * np.pi * (z - 0.55 * y) / 29) * np.exp(-(((x - 45) / 45) ** 2))
    column = np.stack([(x + 80) / (44 - 0.07 * up), (y + 8) / (66 - 0.12 * up)])
    mediastinum = (1 - np.linalg.norm(column, axis=0)) * 38
    midline = -(x + 72)
    spine = 34 - np.hypot(x + 80, y - 76)
    bottom = -(z + 132 + 0.16 * y)
    heart = ball((-72.0, -44.0, -54.0), (67.0, 52.0, 70.0))
    diaphragm = ball((-22.0, -8.0, -166.0), (92.0, 97.0, 84.0))
    fields = np.stack([chest_wall + ribs, mediastinum, midline, spine, bottom, heart, diaphragm])
    solid = smooth_maximum(fields, _BLEND_MM)
    aorta = 13.5 - _distance_to_path(points, _AORTA)
    hilum = ball(tuple(_HILUM), (15.0, 13.0, 22.0))
    return smooth_maximum(np.stack([solid, aorta, hilum]), 2.0)


def _distance_to_path(points: np.ndarray, path: np.ndarray) -> np.ndarray:
    """(Q,) mm from points (Q, 3) to the polyline through path (K, 3)."""
    nearest = np.full(len(points), np.inf)
    for start, end in itertools.pairwise(path):
        along = end - start
        t = np.clip((points - start) @ along / (along @ along), 0, 1)
        nearest = np.minimum(nearest, np.linalg.norm(points - start - t[:, None] * along, axis=1))
    return nearest

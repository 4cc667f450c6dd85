"""A bent, tapering tube with a head, as a left hippocampus is: small, with two labels.

LPS in mm: +x lateral, +y posterior, +z up; the head lies in front, the tail curls up and to the
middle. Most modes bend it or move a part along it, which no affine map does.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from ssm_pipeline.data_prep.synthetic.phantom_family import (
    PhantomFamily,
    level_surface,
    smooth_maximum,
)
from ssm_pipeline.data_prep.synthetic.phantom_flow import Push, Swell, Velocity

# Along the tube from head to tail: centre, and radii across (medial-lateral) and upright.
_LINE = np.array(
    [
        (-6.0, -18.5, -1.5),
        (-1.0, -17.0, -2.0),
        (3.0, -11.0, -2.5),
        (4.5, -4.0, -1.5),
        (4.5, 3.0, 0.0),
        (3.0, 9.5, 2.0),
        (0.0, 14.5, 4.5),
        (-4.5, 17.5, 7.0),
    ]
)
_WIDE = np.array([3.6, 5.2, 5.6, 4.9, 4.4, 3.9, 3.2, 2.2])
_HIGH = np.array([3.4, 4.6, 4.6, 3.8, 3.2, 3.0, 2.7, 2.2])


@cache
def tube_family() -> PhantomFamily:
    """The mean tube of about 3 ml in 4000 vertices, head and body, and its scans."""
    vertices, faces = level_surface(
        _outside_mm, (-16.0, -28.0, -14.0), (16.0, 26.0, 16.0), step_mm=0.6, edge_mm=0.62
    )
    return PhantomFamily(
        organ="hippocampus",
        vertices=vertices,
        faces=faces,
        modes=_MODES,
        border=vertices[:, 1] + 5.0 + 0.25 * vertices[:, 2],  # behind the uncus
        pivot=np.zeros(3),
        residual_mm=0.6,
        residual_widths_mm=(6.0, 3.5),
        in_plane_mm=(1.0, 1.0),
        slice_mm=(1.0, 1.0),
        hilum=np.zeros(0, int),
    )


def _growth(points: np.ndarray) -> np.ndarray:
    """Longer or shorter, and a little thicker: the affine part of what varies."""
    return points * [0.015, 0.022, 0.015]


def _bow(points: np.ndarray) -> np.ndarray:
    """Bent more or less, as seen from above: the ends move to the middle."""
    result: np.ndarray = (1.2 - 3.6 * (points[:, 1:2] / 18) ** 2) * np.array([0.45, 0.0, 0.0])
    return result


def _arch(points: np.ndarray) -> np.ndarray:
    """Bent more or less, as seen from the side: the ends rise."""
    result: np.ndarray = (3.6 * (points[:, 1:2] / 18) ** 2 - 1.2) * np.array([0.0, 0.0, 0.4])
    return result


def _wave(points: np.ndarray) -> np.ndarray:
    """Head, body and tail shifted sideways in turn."""
    result: np.ndarray = np.sin(2 * np.pi * (points[:, 1:2] + 3) / 24) * np.array([0.8, 0.0, -0.4])
    return result


def _twist(points: np.ndarray) -> np.ndarray:
    """The head turns one way about the tube and the tail the other."""
    x, y, z = points.T
    result: np.ndarray = np.column_stack([-z, np.zeros_like(x), x - 1]) * (0.12 * y / 18)[:, None]
    return result


_MODES: tuple[Velocity, ...] = (
    _growth,
    _bow,
    _arch,
    _wave,
    _twist,
    Swell((0.0, -15.0, -2.0), (6.0, 5.0, 6.0), 0.2),  # size of the head
    Push((-6.0, -17.0, -1.0), (3.5, 4.5, 4.0), (-1.5, 0.6, 0.4)),  # how far the uncus reaches
    Push((1.0, -11.0, 4.0), (5.0, 4.0, 3.5), (0.0, 0.0, 1.0)),  # height of the head's ridge
    Swell((4.5, 2.0, 0.0), (6.0, 6.0, 6.0), 0.18),  # thickness of the body
    Push((-4.0, 17.0, 7.0), (5.0, 4.5, 4.5), (-1.3, 0.6, 1.3)),  # length of the tail
    Push((4.0, -3.0, -1.0), (9.0, 6.0, 9.0), (0.0, 1.3, 0.0)),  # where head turns to body
    Push((3.0, 9.0, 3.0), (5.0, 5.0, 4.0), (0.8, 0.0, 0.8)),  # kink before the tail
)


def _outside_mm(points: np.ndarray) -> np.ndarray:
    """(Q,) about the distance outside the mean tube, negative inside: balls along its line."""
    steps = np.linspace(0, len(_LINE) - 1, 40)
    places = np.arange(len(_LINE))
    along = [np.interp(steps, places, values) for values in (*_LINE.T, _WIDE, _HIGH)]
    balls = []
    for x, y, z, wide, high in np.stack(along, axis=1):
        scaled = (points - [x, y, z]) / [wide, (wide + high) / 2, high]
        balls.append((np.linalg.norm(scaled, axis=1) - 1) * high)
    ridge = np.linalg.norm((points - [-0.5, -13.0, 0.8]) / [4.6, 4.0, 3.0], axis=1) - 1
    return smooth_maximum(np.stack([*balls, 2.6 * ridge]), -0.5) + 0.6

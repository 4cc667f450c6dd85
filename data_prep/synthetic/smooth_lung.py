"""The phantom's anatomy: one smooth left lung and the ways in which it varies.

World space is LPS: +x lateral, +y posterior, +z towards the apex; the heart lies at −x, −y.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import trimesh

CENTRE = np.array([78.0, 10.0, 0.0])  # mm, where the left lung lies in the patient
_TOP, _HEIGHT = 130.0, 260.0  # mm, of the lung about its own origin
_BLEND_MM = 7.0  # edges are rounded at about this radius

Field = Callable[[np.ndarray], np.ndarray]


def mean_lung(subdivisions: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (10 242, 3) mm and faces (20 480, 3) of the mean left lung.

    The surface is star-shaped about its origin: each vertex lies on its own ray, so that it
    cannot meet itself. It has an apex, a concave base on the diaphragm with a deep posterior
    recess, a flat mediastinal side, a hollow for the heart, a groove of the aorta and the hilum's
    dent; no two ends are alike.
    """
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
    rays = np.asarray(sphere.vertices) * [45.0, 75.0, 115.0]
    low, high = np.zeros(len(rays)), np.full(len(rays), 2.0)
    for _ in range(60):
        middle = (low + high) / 2
        outside = _outside_mm(middle[:, None] * rays) > 0
        low, high = np.where(outside, low, middle), np.where(outside, middle, high)
    return low[:, None] * rays + CENTRE, np.asarray(sphere.faces, dtype=np.int64)


def mode_fields() -> tuple[Field, ...]:
    """The smooth displacement fields, (V, 3) mm → (V, 3) mm, of one standard deviation each.

    Their gradients are so small that, for scores of Euclidean norm up to 4, the map
    x → x + Σ s_m v_m(x) has a Jacobian with positive definite symmetric part: it is injective,
    and no phantom can fold or meet itself (a test measures it).
    """
    return (_breathing, _depth, _apex_lean, _base_tilt, _cardiac_notch, _width)


def _breathing(points: np.ndarray) -> np.ndarray:
    """Taller or shorter; the apex stays and the base moves by 18 mm."""
    result: np.ndarray = np.array([0, 0, 0.07]) * (points - CENTRE - [0, 0, _TOP])
    return result


def _depth(points: np.ndarray) -> np.ndarray:
    """Deeper or flatter from front to back: 7 mm at either wall."""
    result: np.ndarray = np.array([0, 0.085, 0]) * (points - CENTRE)
    return result


def _apex_lean(points: np.ndarray) -> np.ndarray:
    """The apex leans backwards and to the middle: 15 mm at the top, none at the base."""
    upward = (points[:, 2:] - CENTRE[2] + _TOP) / _HEIGHT
    result: np.ndarray = 15.0 * upward**2 * np.array([-0.5, 0.87, 0])
    return result


def _base_tilt(points: np.ndarray) -> np.ndarray:
    """The base tilts: its back goes down and its front up, 9 mm at 75 mm from the centre."""
    downward = (_TOP + CENTRE[2] - points[:, 2:]) / _HEIGHT
    result: np.ndarray = (
        9.0 * downward**2 * (points[:, 1:2] - CENTRE[1]) / 75 * np.array([0, 0, -1.0])
    )
    return result


def _cardiac_notch(points: np.ndarray) -> np.ndarray:
    """The heart presses in: 8 mm at the hollow, fading over 34 mm."""
    squared = ((points - CENTRE - [-25.0, -45.0, -40.0]) ** 2).sum(axis=1, keepdims=True)
    result: np.ndarray = 8.0 * np.exp(-squared / (2 * 34.0**2)) * np.array([0.8, 0.6, 0])
    return result


def _width(points: np.ndarray) -> np.ndarray:
    """Wider or narrower from side to side: 4 mm at either wall."""
    result: np.ndarray = np.array([0.08, 0, 0]) * (points - CENTRE)
    return result


def _outside_mm(points: np.ndarray) -> np.ndarray:
    """(V,) about the distance outside the mean lung, about its own origin; negative inside."""
    x, y, z = points.T
    up = np.clip((z + 20) / (_TOP + 20), 0, None)  # 0 below the hilum, 1 at the apex
    narrow = 1 - 0.28 * up**2
    shell = np.stack([(x + 10 * up**2) / 62 / narrow, (y - 12 * up**2) / 84 / narrow, z / _TOP])
    outer = ((np.abs(shell) ** 2.5).sum(axis=0) ** (1 / 2.5) - 1) * 75

    def ball(centre: tuple[float, float, float], radii: tuple[float, float, float]) -> np.ndarray:
        scaled = np.linalg.norm((points - centre) / np.array(radii), axis=1)
        result: np.ndarray = (1 - scaled) * min(radii)
        return result

    mediastinum = -(x + 38 + 0.0012 * (y - 5) ** 2)
    diaphragm = ball((-8.0, -18.0, -160.0), (92.0, 96.0, 82.0))
    heart = ball((-62.0, -52.0, -48.0), (48.0, 42.0, 55.0))
    solid = np.stack([outer, mediastinum, diaphragm, heart])
    blended = _BLEND_MM * np.log(np.exp(solid / _BLEND_MM).sum(axis=0))
    hilum = np.exp(-((x + 40) ** 2 / 30**2 + (y - 14) ** 2 / 17**2 + (z - 12) ** 2 / 24**2))
    aorta = np.exp(-((x + 38) ** 2 / 26**2 + (y - 46) ** 2 / 12**2 + (z + 10) ** 2 / 90**2))
    result: np.ndarray = blended + 11 * hilum + 6 * aorta
    return result

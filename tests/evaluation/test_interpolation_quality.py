"""Interpolations whose distortion is known."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh

from ssm_pipeline.evaluation.interpolation_quality import (
    LIMIT,
    interpolation_curve,
    interpolation_quality,
)
from ssm_pipeline.records import ShapePath

TIMES = np.linspace(0, 1, 5)
BALL = trimesh.creation.icosphere(2)
VERTICES, FACES = np.asarray(BALL.vertices) * 30, np.asarray(BALL.faces)


def path_of(shapes: list[np.ndarray], offsets: np.ndarray | None = None) -> ShapePath:
    pose = np.stack(shapes)
    zero = np.zeros_like(pose) if offsets is None else offsets
    return ShapePath("template", "case", TIMES, pose, zero, FACES)


def turned(angle: float) -> np.ndarray:
    cosine, sine = np.cos(angle), np.sin(angle)
    points: np.ndarray = VERTICES @ np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]]).T
    return points


def test_a_turn_keeps_everything_and_the_straight_line_does_not() -> None:
    """Half way through a turn by 120°, the straight line has halved what lies across the axis."""
    path = path_of([turned(t * np.radians(120)) for t in TIMES])
    table = interpolation_quality(path).set_index("t")
    assert table["conformal_distortion"].to_numpy() == pytest.approx(2)
    assert table["conformal_near_2_percent"].to_numpy() == pytest.approx(100)
    for change in ("volume_change_percent", "edge_change_percent"):
        assert table[change].to_numpy() == pytest.approx(0, abs=1e-9)
    half = table.loc[0.5]
    assert half["straight_volume_change_percent"] == pytest.approx(-75)
    assert 20 < half["straight_edge_change_percent"] < 50
    # A triangle across the axis keeps its angles; one along it has σ₁/σ₂ = 2.
    assert 2.1 < half["straight_conformal_distortion"] < 2.5
    for end in (0.0, 1.0):
        assert table.loc[end, "straight_conformal_distortion"] == pytest.approx(2)
    curve = interpolation_curve([path])
    assert (curve["share"] == 1).all()
    assert curve["straight_share"].is_monotonic_increasing
    assert curve["straight_share"].iloc[0] < 0.5 < curve["straight_share"].iloc[-1]
    assert curve["threshold"].iloc[-1] == LIMIT


def test_growth_is_no_distortion() -> None:
    table = interpolation_quality(path_of([VERTICES * (1 + t) for t in TIMES]))
    assert table["conformal_distortion"].to_numpy() == pytest.approx(2)
    assert table["edge_change_percent"].to_numpy() == pytest.approx(0, abs=1e-9)
    # 3.375 at half way, where the even change from 1 to 8 has 4.5.
    assert table["volume_change_percent"].iloc[2] == pytest.approx(100 * (3.375 / 4.5 - 1))


def test_the_path_ends_where_the_correspondence_is() -> None:
    """Offsets count in proportion to the time, and the straight line goes to the same end."""
    offsets = np.broadcast_to(VERTICES * [0.5, 0, 0], (5, *VERTICES.shape))
    table = interpolation_quality(path_of([VERTICES] * 5, offsets))
    own = table["conformal_distortion"].to_numpy()
    assert own == pytest.approx(table["straight_conformal_distortion"].to_numpy())
    assert (np.diff(own) > 0).all()


def test_a_collapsed_triangle_and_an_open_surface_leave_numbers() -> None:
    shapes = [VERTICES.copy() for _ in TIMES]
    shapes[2][FACES[0]] = shapes[2][FACES[0]].mean(axis=0)
    path = path_of(shapes)
    table = interpolation_quality(path)
    assert np.isfinite(table.to_numpy()).all()
    assert 2.03 < table["conformal_distortion"].iloc[2] < 4
    opened = dataclasses.replace(path, faces=FACES[5:])
    table = interpolation_quality(opened)
    assert table["volume_change_percent"].isna().all()
    assert np.isfinite(table["conformal_distortion"]).all()

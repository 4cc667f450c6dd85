"""Figures with merged limbs: sound surfaces whose topology changes, exact truth."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import trimesh

from ssm_pipeline.data_prep.synthetic.articulated_merged import (
    MergedFigure,
    covered_share,
    merged_figure,
    reference,
    union,
)
from ssm_pipeline.data_prep.synthetic.articulated_settings import (
    DEVELOPMENT_SEED,
    ArticulatedSettings,
)
from ssm_pipeline.geometry.surface import volume
from ssm_pipeline.geometry.topology import euler_number, face_components, is_oriented_manifold
from ssm_pipeline.records import Mesh

SETTINGS = ArticulatedSettings(family="merged limbs", persons=2, vertices=3000)


@functools.cache
def figure(index: int) -> MergedFigure:
    return merged_figure(SETTINGS, index)


def two_balls(apart: float) -> Mesh:
    ball = trimesh.creation.icosphere(4, radius=100)
    other = ball.copy()
    other.apply_translation([apart, 3, 7])
    both = trimesh.util.concatenate([ball, other])
    assert isinstance(both, trimesh.Trimesh)
    return Mesh(both.vertices, both.faces, "two balls")


def test_the_union_of_two_balls_has_their_volume_and_one_surface() -> None:
    balls = two_balls(120)
    merged = union(balls)
    radius, apart = 103.0, np.linalg.norm([120, 3, 7])  # grown by 3 mm
    lens = np.pi * (4 * radius + apart) * (2 * radius - apart) ** 2 / 12
    assert volume(merged.vertices, merged.faces) == pytest.approx(
        2 * 4 / 3 * np.pi * radius**3 - lens, rel=0.01
    )
    assert euler_number(merged.faces) == 2
    assert is_oriented_manifold(merged.faces)
    # The cap of each ball that lies in the other: half of 1 − apart / diameter.
    assert covered_share(balls) == pytest.approx(0.5 * (1 - apart / 200), abs=0.05)


def test_a_narrow_gap_closes_and_a_wide_one_does_not() -> None:
    assert face_components(union(two_balls(204)).faces).max() == 0
    narrow, wide = (union(two_balls(apart)) for apart in (204, 220))
    assert np.ptp(narrow.vertices[:, 0]) > 400
    assert np.ptp(wide.vertices[:, 0]) < 230  # the larger piece alone


def test_figures_are_closed_surfaces_and_most_have_handles() -> None:
    eulers = []
    for index in (1, 2):
        mesh = figure(index).mesh
        assert is_oriented_manifold(mesh.faces)
        assert face_components(mesh.faces).max() == 0
        assert 0.85 * 3000 < len(mesh.vertices) < 1.15 * 3000
        eulers.append(euler_number(mesh.faces))
    assert min(eulers) < 2
    assert euler_number(reference(3000).faces) == 2


def test_every_vertex_knows_its_point_of_the_reference() -> None:
    """Neighbours on a figure are neighbours on the reference, but for the seams of contact."""
    rest = reference(3000)
    made = figure(1)
    assert len(made.to_reference) == len(made.mesh.vertices)
    at_rest = rest.vertices[made.to_reference]
    edges = np.linalg.norm(
        at_rest[made.mesh.faces] - at_rest[made.mesh.faces[:, [1, 2, 0]]], axis=2
    )
    assert np.median(edges) < 45  # about one edge of 26 mm
    torn = (edges.max(axis=1) > 150).mean()
    assert 0 < torn < 0.06  # the seams
    # Most of the reference is found again.
    assert len(np.unique(made.to_reference)) > 0.6 * len(rest.vertices)


def test_the_seed_decides_everything() -> None:
    again = merged_figure(SETTINGS, 1)
    assert (again.mesh.vertices == figure(1).mesh.vertices).all()
    assert (again.to_reference == figure(1).to_reference).all()
    other = merged_figure(SETTINGS.model_copy(update={"seed": DEVELOPMENT_SEED}), 1)
    assert len(other.mesh.vertices) != len(again.mesh.vertices)

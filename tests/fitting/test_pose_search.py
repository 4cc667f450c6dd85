from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from cohorts import TURN, bumpy_cohort
from scipy.spatial.transform import Rotation

from ssm_pipeline.fitting.partial import (
    border_vertices,
    lies_on_border,
    opened_at_image_border,
    without_faces,
)
from ssm_pipeline.fitting.pose_search import mirrored, start_poses, turned_deg
from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.geometry.surface import volume
from ssm_pipeline.geometry.topology import boundary_edges
from ssm_pipeline.meshing.mask_to_mesh import mesh_with_quality
from ssm_pipeline.meshing.settings import MeshingSettings
from ssm_pipeline.records import CaseError, Mask, Mesh
from ssm_pipeline.shape_model.alignment import align
from ssm_pipeline.shape_model.pca import pca_model


@pytest.fixture(scope="module")
def model() -> Any:
    return pca_model(align(bumpy_cohort(8))[0])


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_an_organ_upside_down_is_found_so(model: Any, axis: str) -> None:
    half_turn = Rotation.from_euler(axis, np.pi).as_matrix()
    first, other = start_poses(model, Mesh(model.mean @ half_turn.T + 50, model.faces, "turned"))
    assert other.error_mm < 0.7 * first.error_mm
    assert turned_deg(other.frame) > 170


def test_how_the_cases_lie_comes_first(model: Any) -> None:
    upright = Rotation.from_euler("x", 120, degrees=True).as_matrix()
    surface = Mesh(model.mean @ upright.T + 40, model.faces, "lying")
    first = start_poses(model, surface, upright)[0]
    assert turned_deg(Similarity(1.0, upright.T @ first.frame.rotation, np.zeros(3))) < 10


def test_a_mirror_image_is_outward_and_its_own_mirror_image(model: Any) -> None:
    mesh = Mesh(TURN.apply(model.mean), model.faces, "a")
    image = mirrored(mesh)
    assert volume(image.vertices, image.faces) == pytest.approx(volume(mesh.vertices, mesh.faces))
    np.testing.assert_array_equal(mirrored(image).vertices, mesh.vertices)


def test_a_point_beyond_a_border_is_told_from_one_above_the_surface() -> None:
    grid = np.stack(np.meshgrid(range(5), range(5), [0]), axis=-1).reshape(-1, 3).astype(float)
    corners = np.array(
        [[r * 5 + c, r * 5 + c + 1, (r + 1) * 5 + c] for r in range(4) for c in range(4)]
    )
    other = corners + [[1, 5, 0]] * len(corners)
    other[:, 2] = corners[:, 2]
    faces = np.concatenate([corners, other])
    border = border_vertices(faces, 25)
    assert border.sum() == 16
    queries = np.array([[2.2, 2.3, 1.0], [7.0, 2.0, 0.0], [4.0, 2.5, 0.0], [-1, -1, 0.0]])
    found = closest_points(queries, grid, faces)
    np.testing.assert_array_equal(lies_on_border(found, faces, border), [False, True, True, True])


def ball_in_a_short_image(slices: int) -> Mask:
    """A ball of 20 mm around slice 24 of 2 mm voxels; the image ends after `slices` slices."""
    z, y, x = np.indices((slices, 44, 44))
    inside = (z - 24) ** 2 + (y - 22) ** 2 + (x - 22) ** 2 < 18**2
    return Mask(inside, np.full(3, 2.0), np.array([10.0, -30.0, 500.0]), np.eye(3), "ball")


@pytest.mark.parametrize(("slices", "holes"), [(48, 0), (30, 1)])
def test_the_cap_where_the_image_ends_is_taken_off(slices: int, holes: int) -> None:
    mask = ball_in_a_short_image(slices)
    mesh, _ = mesh_with_quality(mask, MeshingSettings(faces=1500))
    opened = opened_at_image_border(mesh, mask, margin_mm=4.0)
    assert bool(len(boundary_edges(opened.faces))) == bool(holes)
    if holes:
        # The cap is a disc of radius √(18² − 5²) voxels; nothing below its rim is taken.
        top = 500 + 2.0 * 29
        lost = ~np.isin(mesh.vertices.round(6), opened.vertices.round(6)).all(axis=1)
        assert mesh.vertices[lost, 2].min() > top - 4.5
        assert opened.vertices[:, 2].max() < top + 2.0
        assert lost.sum() > 20


def test_a_turned_images_cap_is_taken_off_too() -> None:
    mask = ball_in_a_short_image(30)
    turn = Rotation.from_euler("xyz", [30, 10, -50], degrees=True).as_matrix()
    turned = Mask(mask.voxels, mask.spacing_mm, mask.origin_mm, turn, "ball")
    mesh, _ = mesh_with_quality(mask, MeshingSettings(faces=1500))
    moved = Mesh((mesh.vertices - mask.origin_mm) @ turn.T + mask.origin_mm, mesh.faces, "ball")
    straight, skew = (
        opened_at_image_border(mesh, mask, 4.0),
        opened_at_image_border(moved, turned, 4.0),
    )
    np.testing.assert_array_equal(straight.faces, skew.faces)


def test_only_caps_is_no_surface() -> None:
    mask = Mask(np.ones((4, 4, 4), bool), np.ones(3), np.zeros(3), np.eye(3), "full")
    corners = np.array([[-0.5, -0.5, -0.5], [3.5, -0.5, -0.5], [-0.5, 3.5, -0.5]])
    lid = Mesh(corners, np.array([[0, 2, 1]]), "full")
    with pytest.raises(CaseError, match="fills the image"):
        opened_at_image_border(lid, mask, 2.0)


def test_dropping_faces_drops_their_vertices() -> None:
    mesh = Mesh(np.eye(4, 3), np.array([[0, 1, 2], [1, 3, 2]]), "two")
    left = without_faces(mesh, np.array([True, False]))
    np.testing.assert_array_equal(left.vertices, np.eye(4, 3)[1:])
    np.testing.assert_array_equal(left.faces, [[0, 2, 1]])

"""Any mask, and any surface, gives one closed mesh or an error that names the case; and the mesh
lies where the header says, whatever the labels are called."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from mask_shapes import ball, mask_of
from scipy.spatial.transform import Rotation

from ssm_pipeline.data_prep.formats.label_images import LabelImage
from ssm_pipeline.data_prep.formats.organ_masks import select_labels
from ssm_pipeline.geometry.surface import volume
from ssm_pipeline.geometry.topology import euler_number, face_components, is_oriented_manifold
from ssm_pipeline.meshing.mask_to_mesh import mesh_with_quality
from ssm_pipeline.meshing.organ import keep_organ
from ssm_pipeline.meshing.settings import MeshingSettings
from ssm_pipeline.meshing.surface_labels import surface_labels
from ssm_pipeline.meshing.surface_to_mesh import mesh_from_surface
from ssm_pipeline.records import CaseError, Mask, Mesh, Surface

FEW = MeshingSettings(faces=300)
SIDES = st.integers(1, 7)
VOXEL_MM = st.sampled_from([0.3, 1.0, 5.0])
# A bean: no symmetry, so that a mesh that is turned or mirrored lies elsewhere.
BEAN = mask_of(lambda p: ball(9)(p) & ~ball(5)(p - [7, 3, 1]) | ball(4)(p - [-6, 5, 4]), 12)


def made(make: Callable[[], Mesh]) -> Mesh | None:
    """None where the case is refused; any other error is one of ours."""
    try:
        return make()
    except CaseError as error:
        refused = error
    assert refused.case_id == "any"
    return None


def is_sound(mesh: Mesh) -> None:
    assert np.isfinite(mesh.vertices).all()
    assert is_oriented_manifold(mesh.faces)
    assert len(np.unique(face_components(mesh.faces))) == 1
    assert euler_number(mesh.faces) == 2
    assert volume(mesh.vertices, mesh.faces) > 0


def few(voxel_mm: float) -> MeshingSettings:
    return MeshingSettings(faces=300, voxel_mm=voxel_mm, smoothing_mm=0.7 * voxel_mm)


@settings(max_examples=40, deadline=None)
@given(data=st.data(), sides=st.tuples(SIDES, SIDES, SIDES), spacing=st.tuples(*[VOXEL_MM] * 3))
def test_any_small_mask_gives_a_closed_mesh_or_a_reason(
    data: Any, sides: Any, spacing: Any
) -> None:
    mesh_of_voxels(data.draw(arrays(bool, sides)), spacing)


def test_dense_small_masks_are_meshed() -> None:
    """The test above would also pass if every mask were refused."""
    generator = np.random.default_rng(0)
    for spacing in ((1.0, 1.0, 1.0), (0.3, 0.3, 1.0)):
        assert mesh_of_voxels(generator.random((5, 6, 7)) < 0.8, spacing) is not None


def mesh_of_voxels(voxels: np.ndarray, spacing: tuple[float, float, float]) -> Mesh | None:
    """A sound mesh with the organ's volume, or None where the mask is refused."""
    mask = Mask(voxels, np.array(spacing), np.array([5.0, -3, 100]), np.eye(3), "any")
    mesh = made(lambda: mesh_with_quality(mask, FEW)[0])
    if mesh is not None:
        is_sound(mesh)
        np.testing.assert_allclose(
            volume(mesh.vertices, mesh.faces), keep_organ(mask)[0].volume_mm3, rtol=1e-3
        )
    return mesh


@settings(max_examples=10, deadline=None)
@given(
    shift=st.tuples(*[st.floats(-500, 500)] * 3),
    turn=st.integers(0, 2**32 - 1),
    larger=st.sampled_from([0.25, 0.5, 1.0]),
)
def test_the_mesh_goes_where_the_header_goes(shift: Any, turn: Any, larger: Any) -> None:
    """Moved, turned and made smaller by the header alone: every vertex is, too."""
    rotation = Rotation.random(random_state=turn).as_matrix()
    moved = dataclasses.replace(
        BEAN,
        spacing_mm=BEAN.spacing_mm * larger,
        origin_mm=larger * rotation @ BEAN.origin_mm + shift,
        direction=rotation @ BEAN.direction,
    )
    still = mesh_with_quality(BEAN, few(voxel_mm=1.0))[0]
    expected = Mesh(larger * still.vertices @ rotation.T + shift, still.faces, "test")
    found = mesh_with_quality(moved, few(voxel_mm=larger))[0]
    np.testing.assert_array_equal(found.faces, expected.faces)
    np.testing.assert_allclose(found.vertices, expected.vertices, atol=1e-6)  # found: 1e-9


@settings(max_examples=20, deadline=None)
@given(names=st.permutations([1, 2, 3, 7, 200]), wanted=st.sets(st.integers(0, 4), min_size=2))
def test_what_labels_are_called_does_not_matter(names: Any, wanted: Any) -> None:
    """The same parts by other numbers: the same mask, and the same parts on its surface."""
    parts = np.random.default_rng(0).integers(-1, 5, BEAN.voxels.shape)  # -1: background

    def organ(called: list[int]) -> Mask:
        labels = np.array([*called, 0], np.int16)[parts]
        image = LabelImage(labels, BEAN.spacing_mm, BEAN.origin_mm, BEAN.direction, "any")
        return select_labels(image, tuple(called[part] for part in wanted))

    one, other = organ([1, 2, 3, 4, 5]), organ(names)
    np.testing.assert_array_equal(one.voxels, other.voxels)
    size = np.array(BEAN.voxels.shape[::-1]) - 1.0
    mesh = Mesh(BEAN.to_world((BOX.vertices + 0.5) * size), BOX.faces, "any")
    ours, theirs = surface_labels(mesh, one), surface_labels(mesh, other)
    order = [list(theirs.values).index(names[label - 1]) for label in ours.values]
    np.testing.assert_allclose(ours.shares, theirs.shares[:, order])


BOX = trimesh.creation.box()
SPHERE = trimesh.creation.icosphere(2, radius=20.0)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    kept=st.sampled_from([0.5, 0.9, 0.99, 1.0]),
    turned=st.sampled_from([0.0, 0.1, 1.0]),
    doubled=st.integers(0, 8),
    joined=st.integers(0, 6),
    noise_mm=st.sampled_from([0.0, 1e-6, 0.5, 10.0]),
)
def test_any_surface_gives_a_closed_mesh_or_a_reason(
    seed: int, kept: Any, turned: Any, doubled: Any, joined: Any, noise_mm: Any
) -> None:
    damaged_sphere(seed, kept, turned, doubled, joined, noise_mm)


def test_surfaces_with_little_damage_are_meshed() -> None:
    """The test above would also pass if every surface were refused."""
    for seed in range(3):
        assert damaged_sphere(seed, 1.0, 0.1, 4, 0, 1e-6) is not None
        assert damaged_sphere(seed, 1.0, 1.0, 8, 0, 0.0) is not None


def damaged_sphere(
    seed: int, kept: float, turned: float, doubled: int, joined: int, noise_mm: float
) -> Mesh | None:
    """The mesh of a sphere whose triangles are missing, reversed or doubled, and whose vertices
    are moved or joined; None where the surface is refused."""
    generator = np.random.default_rng(seed)
    faces = np.array(SPHERE.faces)
    faces = faces[generator.random(len(faces)) < kept]
    inward = generator.random(len(faces)) < turned
    faces[inward] = faces[inward, ::-1]
    faces = np.vstack([faces, faces[generator.integers(len(faces), size=doubled)]])
    vertices = SPHERE.vertices + noise_mm * generator.standard_normal(SPHERE.vertices.shape)
    onto = generator.integers(len(vertices), size=(2, joined))
    vertices[onto[0]] = vertices[onto[1]]
    mesh = made(lambda: mesh_from_surface(Surface(vertices, faces, "any"), FEW)[0])
    if mesh is not None:
        is_sound(mesh)
    return mesh

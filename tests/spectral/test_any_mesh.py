"""Any mesh that passes `Mesh`'s checks gives finite operators, or an error that names the case."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapes import basis_of, sphere

from ssm_pipeline.geometry.surface import vertex_normals
from ssm_pipeline.records import CaseError, Mesh

BALL = sphere(subdivisions=2)
VERTICES, FACES = BALL.vertices, BALL.faces
COUNT = len(VERTICES)


def with_a_fold() -> Mesh:
    """A flap of no thickness on one edge: the normals of its two triangles cancel at its tip."""
    a, b = FACES[0, :2]
    tip = VERTICES[a] * 1.5
    flap = [[a, b, COUNT], [b, a, COUNT]]
    return Mesh(np.vstack([VERTICES, tip]), np.vstack([FACES, flap]), "fold")


def with_vertices_in_one_place() -> Mesh:
    moved = VERTICES.copy()
    moved[FACES[0, 1]] = moved[FACES[0, 0]]
    return Mesh(moved, FACES, "collapsed edge")


def with_a_second_piece() -> Mesh:
    small = sphere(radius=1e-3, subdivisions=0)
    vertices = np.vstack([VERTICES, small.vertices + 3])
    return Mesh(vertices, np.vstack([FACES, small.faces + COUNT]), "two pieces")


ODD = {
    "fold": with_a_fold(),
    "collapsed edge": with_vertices_in_one_place(),
    "second piece": with_a_second_piece(),
    "unused vertex": Mesh(np.vstack([VERTICES, [[9.0, 2, 5]]]), FACES, "unused"),
    "corners repeated": Mesh(VERTICES, np.vstack([FACES, [[0, 0, 1], [1, 1, 1]]]), "degenerate"),
    "triangles twice": Mesh(VERTICES, np.vstack([FACES, FACES[:5]]), "twice"),
    "boundary": Mesh(VERTICES, FACES[40:], "open"),
    "turned triangle": Mesh(VERTICES, np.vstack([FACES[:1, ::-1], FACES[1:]]), "turned"),
}


@pytest.mark.parametrize("mesh", ODD.values(), ids=ODD.keys())
def test_odd_meshes_have_operators_and_nearly_the_spectrum_of_the_sphere(mesh: Mesh) -> None:
    basis = basis_of(mesh, 20)  # refuses what is not finite
    gap = np.sort(basis.eigenvalues)[3:5]
    assert (gap > 1).all(), "more than pieces and the fold's tip have become zero"
    assert np.isfinite(basis.gradient_x @ basis.eigenvectors).all()


def test_a_fold_has_no_normal_and_is_given_its_neighbours() -> None:
    mesh = with_a_fold()
    assert not vertex_normals(mesh.vertices, mesh.faces)[COUNT].any()
    basis = basis_of(mesh, 20)
    assert np.abs(basis.gradient_x[COUNT]).max() > 0


def test_an_unused_vertex_weighs_nothing_and_follows_its_neighbour() -> None:
    basis = basis_of(ODD["unused vertex"], 20)
    plain = basis_of(BALL, 20)
    assert basis.mass[COUNT] == 0
    np.testing.assert_allclose(basis.mass[:COUNT], plain.mass)
    np.testing.assert_allclose(basis.eigenvalues, plain.eigenvalues, atol=1e-8)
    nearest = np.linalg.norm(VERTICES - [9.0, 2, 5], axis=1).argmin()
    np.testing.assert_allclose(basis.eigenvectors[COUNT], basis.eigenvectors[nearest])


def test_what_is_no_surface_is_refused_by_name() -> None:
    flat = Mesh(np.zeros((300, 3)), np.arange(300).reshape(-1, 3), "point")
    with pytest.raises(CaseError, match="case point: its 100 triangles have no area"):
        basis_of(flat, 20)
    generator = np.random.default_rng(0)
    soup = Mesh(generator.standard_normal((300, 3)), np.arange(300).reshape(-1, 3), "soup")
    with pytest.raises(CaseError, match="case soup: the mesh falls into 100 pieces"):
        basis_of(soup, 20)


def test_a_basis_that_is_not_finite_is_refused_with_the_vertex() -> None:
    basis = basis_of(BALL, 10)
    broken = basis.gradient_x.copy()
    broken.data[broken.indptr[7]] = np.nan
    with pytest.raises(CaseError, match="case sphere: gradient_x is not finite at row 7"):
        dataclasses.replace(basis, gradient_x=broken)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    kept=st.floats(0.3, 1.0),
    doubled=st.integers(0, 8),
    moved=st.integers(0, 20),
    shifted=st.sampled_from([0.0, 1e-9, 1e-3, 0.5]),
)
def test_damaged_spheres_are_finite_or_refused(
    seed: int, kept: Any, doubled: Any, moved: Any, shifted: Any
) -> None:
    """Triangles missing, doubled or turned, vertices laid on others or pushed about."""
    generator = np.random.default_rng(seed)
    faces = FACES[generator.random(len(FACES)) < kept]
    faces = np.vstack([faces, faces[generator.integers(len(faces), size=doubled), ::-1]])
    vertices = VERTICES + shifted * generator.standard_normal(VERTICES.shape)
    onto = generator.integers(COUNT, size=(2, moved))
    vertices[onto[0]] = vertices[onto[1]]
    try:
        basis = basis_of(Mesh(vertices, faces, "damaged"), 12)
    except CaseError:
        return
    assert np.isfinite(basis.gradient_y @ basis.eigenvectors).all()

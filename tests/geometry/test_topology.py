"""Known topologies: tetrahedron, sphere, torus, open and damaged meshes."""

import numpy as np
import pytest
import trimesh

from ssm_pipeline.geometry.topology import (
    boundary_edges,
    boundary_loop_count,
    directed_edges,
    edges,
    euler_number,
    face_components,
    is_oriented_manifold,
    min_angle_deg,
    opposite_edges,
)

TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


def sphere_faces() -> np.ndarray:
    return np.asarray(trimesh.creation.icosphere(subdivisions=2).faces)


def torus_faces() -> np.ndarray:
    return np.asarray(trimesh.creation.torus(20.0, 5.0).faces)


@pytest.mark.parametrize(
    ("faces", "expected"), [(TETRAHEDRON, 2), (sphere_faces(), 2), (torus_faces(), 0)]
)
def test_euler_number_of_closed_surfaces(faces: np.ndarray, expected: int) -> None:
    assert euler_number(faces) == expected
    assert boundary_loop_count(faces) == 0
    assert is_oriented_manifold(faces)


def test_unused_vertices_do_not_count() -> None:
    assert euler_number(TETRAHEDRON + 7) == 2
    assert is_oriented_manifold(TETRAHEDRON + 7)


def test_holes_are_counted_as_loops() -> None:
    faces = sphere_faces()
    first = faces[0]
    apart = np.flatnonzero(~np.isin(faces, first).any(axis=1))[0]
    open_twice = np.delete(faces, [0, apart], axis=0)
    assert boundary_loop_count(open_twice) == 2
    assert len(boundary_edges(open_twice)) == 6
    assert euler_number(open_twice) == 0
    assert not is_oriented_manifold(open_twice)


def test_a_turned_triangle_is_not_oriented() -> None:
    faces = sphere_faces().copy()
    faces[3] = faces[3, ::-1]
    assert not is_oriented_manifold(faces)
    assert boundary_loop_count(faces) == 0


def test_two_tetrahedra_on_one_vertex_are_not_manifold() -> None:
    second = np.where(TETRAHEDRON == 0, 0, TETRAHEDRON + 3)
    assert not is_oriented_manifold(np.concatenate([TETRAHEDRON, second]))


def test_two_tetrahedra_on_one_edge_are_not_manifold() -> None:
    second = np.where(TETRAHEDRON <= 1, TETRAHEDRON, TETRAHEDRON + 2)
    assert not is_oriented_manifold(np.concatenate([TETRAHEDRON, second]))


def test_components() -> None:
    piece = face_components(np.concatenate([TETRAHEDRON, TETRAHEDRON + 4]))
    assert len(set(piece[:4])) == len(set(piece[4:])) == 1
    assert piece[0] != piece[-1]


def test_min_angle_of_a_known_triangle() -> None:
    vertices = np.array([[0.0, 0, 0], [np.sqrt(3.0), 0, 0], [0, 1, 0]])
    assert min_angle_deg(vertices, np.array([[0, 1, 2]])) == pytest.approx(30)
    assert min_angle_deg(5 * vertices, np.array([[2, 0, 1]])) == pytest.approx(30)


def test_edges_are_listed_once_and_euler_counts_them() -> None:
    faces = trimesh.creation.icosphere(2).faces
    listed = edges(faces)
    assert len(listed) == 3 * len(faces) / 2
    assert (listed[:, 0] < listed[:, 1]).all()
    assert {tuple(edge) for edge in listed} == {
        tuple(sorted(edge)) for edge in directed_edges(faces).tolist()
    }
    assert len(np.unique(faces)) - len(listed) + len(faces) == euler_number(faces) == 2


def test_opposite_edges_run_the_other_way_and_end_at_a_boundary() -> None:
    faces = np.array(trimesh.creation.icosphere(1).faces)
    opposite = opposite_edges(faces)
    np.testing.assert_array_equal(directed_edges(faces)[opposite], directed_edges(faces)[:, ::-1])
    np.testing.assert_array_equal(opposite[opposite], np.arange(len(opposite)))
    assert (opposite_edges(faces[1:]) < 0).sum() == len(boundary_edges(faces[1:])) == 3

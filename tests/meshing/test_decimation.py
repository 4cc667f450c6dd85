"""Decimation keeps surface, volume and topology, and refuses what it can't keep."""

import numpy as np
import pymeshlab
import pytest
import trimesh

from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.geometry.surface import face_normals, volume
from ssm_pipeline.geometry.topology import euler_number, is_oriented_manifold, min_angle_deg
from ssm_pipeline.meshing.decimation import check_decimation_available, decimate
from ssm_pipeline.records import CaseError, Mesh


def ellipsoid(subdivisions: int = 5) -> Mesh:
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
    return Mesh(np.asarray(sphere.vertices) * [30, 50, 80], sphere.faces, "ellipsoid")


@pytest.mark.parametrize("faces", [8000, 2000, 500])
def test_ellipsoid(faces: int) -> None:
    mesh = ellipsoid()
    coarse = decimate(mesh, faces)
    assert 0.98 * faces <= len(coarse.faces) <= faces
    assert is_oriented_manifold(coarse.faces)
    assert euler_number(coarse.faces) == 2
    assert volume(coarse.vertices, coarse.faces) == pytest.approx(
        volume(mesh.vertices, mesh.faces), rel=1e-5
    )
    distances = closest_points(coarse.vertices, mesh.vertices, mesh.faces).distances
    # A flat triangle of edge e lies e²/8R below a surface of radius R: the volume is given back
    # over all vertices, about half of that.
    edge = np.sqrt(4 / np.sqrt(3) * 3.5e4 / faces)
    assert distances.max() < edge**2 / 8 / 20
    assert min_angle_deg(coarse.vertices, coarse.faces) > 10
    outward = np.einsum(
        "fd,fd->f",
        face_normals(coarse.vertices, coarse.faces),
        coarse.vertices[coarse.faces].mean(axis=1) / np.array([30, 50, 80]) ** 2,
    )
    assert (outward > 0).all()


def test_the_fast_first_step_ends_on_the_same_surface() -> None:
    mesh = ellipsoid()
    fast, exact = decimate(mesh, 2000, fast_faces=6000), decimate(mesh, 2000, fast_faces=10**6)
    assert not np.array_equal(fast.faces, exact.faces)
    assert closest_points(fast.vertices, exact.vertices, exact.faces).distances.mean() < 0.1


def test_a_torus_keeps_its_handle() -> None:
    torus = trimesh.creation.torus(30.0, 10.0, major_sections=80, minor_sections=40)
    coarse = decimate(Mesh(torus.vertices, torus.faces, "torus"), 1000)
    assert euler_number(coarse.faces) == 0
    assert is_oriented_manifold(coarse.faces)


def test_a_small_mesh_is_returned_as_it_is() -> None:
    mesh = ellipsoid(2)
    assert decimate(mesh, 320) is mesh


def test_same_input_same_bits() -> None:
    first, second = decimate(ellipsoid(4), 700), decimate(ellipsoid(4), 700)
    np.testing.assert_array_equal(first.vertices, second.vertices)
    np.testing.assert_array_equal(first.faces, second.faces)


def test_an_open_mesh_is_refused_by_name() -> None:
    mesh = ellipsoid(4)
    with pytest.raises(CaseError, match=r"ellipsoid.*not a closed"):
        decimate(Mesh(mesh.vertices, mesh.faces[:-1], "ellipsoid"), 500)


def test_missing_filter_names_the_libraries(monkeypatch: pytest.MonkeyPatch) -> None:
    check_decimation_available()
    monkeypatch.delattr(pymeshlab.MeshSet, "meshing_decimation_quadric_edge_collapse")
    with pytest.raises(RuntimeError, match="libopengl0"):
        check_decimation_available()

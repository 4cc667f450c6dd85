"""Surfaces as files give them: what can be mended is, and told; what can't names its case."""

import numpy as np
import pytest
import trimesh
from shapes import blob, sphere

from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.geometry.surface import volume
from ssm_pipeline.geometry.topology import euler_number, is_oriented_manifold
from ssm_pipeline.meshing.repair import repair
from ssm_pipeline.meshing.settings import MeshingSettings
from ssm_pipeline.meshing.surface_to_mesh import mesh_from_surface
from ssm_pipeline.records import CaseError, Mesh, Surface

SETTINGS = MeshingSettings(faces=600)


def surface_of(mesh: Mesh, faces: np.ndarray | None = None) -> Surface:
    return Surface(mesh.vertices, mesh.faces if faces is None else faces, "case_7")


def soup_of(mesh: Mesh) -> Surface:
    """Every triangle with vertices of its own, as an STL file holds them."""
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)
    return Surface(corners, np.arange(len(corners)).reshape(-1, 3), "case_7")


BALL = blob(0, faces=2000)


def test_a_whole_surface_is_only_remeshed() -> None:
    mesh, quality = mesh_from_surface(surface_of(BALL), SETTINGS)
    assert quality.warnings == ()
    assert is_oriented_manifold(mesh.faces)
    assert 570 <= len(mesh.faces) <= 600
    assert quality.volume_change_percent == pytest.approx(0, abs=1e-3)  # given back by decimation
    distances = closest_points(mesh.vertices, BALL.vertices, BALL.faces).distances
    assert distances.max() < 1.0  # of 100 mm, at edges of 10 mm
    assert quality.surface_hd95_mm < 1.0


def test_a_coarse_surface_is_made_as_dense_as_the_study() -> None:
    mesh, _ = mesh_from_surface(surface_of(blob(1, faces=200)), MeshingSettings(faces=1000))
    assert 950 <= len(mesh.faces) <= 1000
    assert is_oriented_manifold(mesh.faces)


def test_loose_triangles_are_joined() -> None:
    mesh, told = repair(soup_of(BALL), 1.0)
    assert told == ()
    assert len(mesh.vertices) == len(BALL.vertices)
    assert volume(mesh.vertices, mesh.faces) == pytest.approx(volume(BALL.vertices, BALL.faces))


def test_corners_that_differ_in_the_last_digit_are_joined() -> None:
    """An STL written after a transform: its equal corners differ by rounding errors."""
    soup = soup_of(BALL)
    for jitter_mm in (1e-6, 1e-4):  # of a surface of about 100 mm
        noise = np.random.default_rng(0).normal(0, jitter_mm, soup.vertices.shape)
        mesh, told = repair(Surface(soup.vertices + noise, soup.faces, "case_7"), 1.0)
        assert told == ()
        assert len(mesh.vertices) == len(BALL.vertices)
        assert len(mesh.faces) == len(BALL.faces)


def test_a_gap_is_not_welded() -> None:
    """Corners that lie apart by a visible distance stay apart: the surface is refused."""
    soup = soup_of(BALL)
    noise = np.random.default_rng(0).normal(0, 0.1, soup.vertices.shape)
    with pytest.raises(CaseError, match="case_7"):
        repair(Surface(soup.vertices + noise, soup.faces, "case_7"), 1.0)


def test_faces_that_look_inward_and_each_their_own_way() -> None:
    inward, told = repair(surface_of(BALL, BALL.faces[:, ::-1]), 1.0)
    assert volume(inward.vertices, inward.faces) > 0
    assert "pointed inward" in told[0]
    mixed = BALL.faces.copy()
    turned = np.random.default_rng(0).random(len(mixed)) < 0.4
    mixed[turned] = mixed[turned][:, ::-1]
    mesh, _ = repair(surface_of(BALL, mixed), 1.0)
    assert is_oriented_manifold(mesh.faces)
    assert volume(mesh.vertices, mesh.faces) == pytest.approx(volume(BALL.vertices, BALL.faces))


def test_doubled_triangles_and_triangles_without_area() -> None:
    faces = np.concatenate([BALL.faces, BALL.faces[:50], [[3, 3, 8]]])
    mesh, told = repair(surface_of(BALL, faces), 1.0)
    assert len(mesh.faces) == len(BALL.faces)
    assert told == ()


def test_small_holes_are_closed_and_told() -> None:
    near = [np.linalg.norm(BALL.vertices - BALL.vertices[v], axis=1) for v in (0, 500)]
    holes = np.flatnonzero(np.minimum(*near) < 1e-9)
    faces = BALL.faces[~np.isin(BALL.faces, holes).any(axis=1)]
    mesh, told = repair(surface_of(BALL, faces), 1.0)
    assert told == ("2 small holes closed",)
    assert euler_number(mesh.faces) == 2
    assert volume(mesh.vertices, mesh.faces) == pytest.approx(
        volume(BALL.vertices, BALL.faces), rel=0.01
    )


def test_a_large_hole_drops_the_case() -> None:
    middles = BALL.vertices[BALL.faces].mean(axis=1)
    faces = BALL.faces[middles[:, 2] < np.percentile(middles[:, 2], 85)]
    with pytest.raises(CaseError, match=r"case_7: .*1 hole, 1 of them large: .*hole_percent"):
        repair(surface_of(BALL, faces), 1.0)
    mesh, _ = repair(surface_of(BALL, faces), 50.0)
    assert is_oriented_manifold(mesh.faces)


def test_a_second_sheet_on_an_edge_is_cut_out() -> None:
    a, b = BALL.faces[10, :2]
    vertices = np.vstack([BALL.vertices, BALL.vertices[a] + [40.0, 0, 0]])
    fin = Surface(vertices, np.vstack([BALL.faces, [a, b, len(BALL.vertices)]]), "case_7")
    mesh, told = repair(fin, 1.0)
    assert "edges of three or more" in told[0]
    assert is_oriented_manifold(mesh.faces)


def test_stray_pieces_are_left_out() -> None:
    stray = sphere(8.0, case_id="case_7")
    faces = np.vstack([BALL.faces, stray.faces + len(BALL.vertices)])
    both = Surface(np.vstack([BALL.vertices, stray.vertices + 200]), faces, "case_7")
    mesh, told = repair(both, 1.0)
    assert len(mesh.faces) == len(BALL.faces)
    assert "stray pieces" in told[0]


def test_a_surface_that_cuts_through_itself() -> None:
    crushed = BALL.vertices * np.where(BALL.vertices[:, :1] > 0, [-0.9, 1, 1], [1.0, 1, 1])
    with pytest.raises(CaseError, match=r"case_7: (\d+ % of the triangles cut|.*encloses)"):
        repair(Surface(crushed, BALL.faces, "case_7"), 1.0)


def test_a_sheet_is_no_organ() -> None:
    box = trimesh.creation.box((80.0, 60.0, 0.001)).subdivide().subdivide()
    with pytest.raises(CaseError, match=r"case_7: .*encloses .* a sheet or a double wall"):
        repair(Surface(box.vertices, box.faces, "case_7"), 1.0)


def test_a_mobius_band_has_no_inside() -> None:
    angles = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    rims = [
        np.column_stack(
            [
                (20 + side * np.cos(angles / 2)) * np.cos(angles),
                (20 + side * np.cos(angles / 2)) * np.sin(angles),
                side * np.sin(angles / 2),
            ]
        )
        for side in (-5, 5)
    ]
    here, there = np.arange(40), np.roll(np.arange(40), -1)
    low, high = here, here + 40
    next_low, next_high = there.copy(), there + 40
    next_low[-1], next_high[-1] = 40, 0  # the half turn
    faces = np.vstack(
        [np.column_stack([low, next_low, high]), np.column_stack([high, next_low, next_high])]
    )
    with pytest.raises(CaseError, match="case_7"):
        repair(Surface(np.vstack(rims), faces, "case_7"), 100.0)


def test_nothing_to_repair() -> None:
    with pytest.raises(CaseError, match="no triangles"):
        Surface(np.zeros((5, 3)), np.zeros((0, 3), int), "case_7")
    with pytest.raises(CaseError, match="0 triangles with an area"):
        repair(Surface(np.zeros((5, 3)), np.array([[0, 1, 2]]), "case_7"), 1.0)

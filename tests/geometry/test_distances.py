import numpy as np
import pytest
import trimesh
from scipy.spatial.distance import cdist

from ssm_pipeline.geometry.distances import (
    PointTarget,
    SurfaceTarget,
    chamfer,
    surface_distance,
    symmetric,
)


def sphere(radius: float, subdivisions: int = 4) -> SurfaceTarget:
    mesh = trimesh.creation.icosphere(subdivisions, radius=radius)
    return SurfaceTarget.of(np.array(mesh.vertices), np.array(mesh.faces))


def test_surface_distance_of_concentric_spheres_is_the_gap() -> None:
    distance = surface_distance(sphere(50), sphere(53))
    # Triangles cut below the sphere by at most r (1 - cos(edge / √3)) = 0.04 mm here.
    assert distance.mean == pytest.approx(3, abs=0.04)
    assert distance.hd95 == pytest.approx(3, abs=0.04)


def test_hd95_takes_the_worse_direction() -> None:
    half = trimesh.creation.icosphere(3, radius=50)
    upper = half.vertices[half.faces].mean(axis=1)[:, 2] > 0
    part = SurfaceTarget.of(np.array(half.vertices), np.array(half.faces[upper]))
    # Unreferenced vertices would count as surface: keep those of the half only.
    used = np.unique(part.faces)
    vertices = np.searchsorted(used, part.faces)
    cut = SurfaceTarget.of(part.vertices[used], vertices)
    whole = sphere(50, 3)
    assert cut.distances_to(cut.vertices).max() < 1e-6
    assert whole.distances_to(cut.vertices).max() < 1e-6
    # From the far pole to the rim: √2 · 50; 95 % of the vertices lie a little nearer.
    assert 50 < surface_distance(cut, whole).hd95 < 50 * np.sqrt(2) + 1


def test_chamfer_of_radially_moved_points_is_the_move() -> None:
    # Moved by less than half the spacing, every point's nearest neighbour is its own image.
    points = np.array(trimesh.creation.icosphere(2, radius=50).vertices)
    moved = PointTarget.of(points * 52 / 50)
    assert chamfer(PointTarget.of(points), moved) == pytest.approx(2, abs=1e-4)


def test_chamfer_equals_brute_force_and_is_symmetric() -> None:
    generator = np.random.default_rng(0)
    a, b = generator.normal(size=(300, 3)) * 30, generator.normal(size=(200, 3)) * 30 + 5
    table = cdist(a, b)
    expected = 0.5 * (table.min(axis=1).mean() + table.min(axis=0).mean())
    first, second = PointTarget.of(a), PointTarget.of(b)
    assert chamfer(first, second) == pytest.approx(expected, rel=1e-5)  # float32
    assert chamfer(second, first) == pytest.approx(expected, rel=1e-5)


def test_chamfer_floor_of_even_samples() -> None:
    # Free draws of density ρ have a mean nearest-neighbour distance of 1 / (2 √ρ).
    generator = np.random.default_rng(1)
    squares = [
        np.column_stack([generator.random((4000, 2)) * 100, np.zeros(4000)]) for _ in range(2)
    ]
    floor = chamfer(*(PointTarget.of(square) for square in squares))
    assert floor == pytest.approx(0.5 * np.sqrt(100**2 / 4000), rel=0.05)  # edges, 4000 draws


def test_symmetric_takes_the_mean_of_the_means_and_the_worse_tail() -> None:
    near, far = np.zeros(10), np.linspace(0, 10, 1001)
    for pair in ((near, far), (far, near)):
        both = symmetric(*pair)
        assert both.mean == pytest.approx(2.5)  # not weighted by how many points there are
        assert both.hd95 == pytest.approx(9.5)

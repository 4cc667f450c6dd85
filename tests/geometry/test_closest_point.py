import numpy as np
from shapes import sphere

from ssm_pipeline.geometry.closest_point import closest_points


def test_distance_to_a_sphere_is_the_distance_to_its_radius() -> None:
    ball = sphere(radius=10.0, subdivisions=4)
    queries = np.random.default_rng(0).standard_normal((50, 3)) * 12
    found = closest_points(queries, ball.vertices, ball.faces)
    exact = np.abs(np.linalg.norm(queries, axis=1) - 10)
    # Triangles lie inside the sphere, by at most edge² / 8r = 0.02 here.
    np.testing.assert_allclose(found.distances, exact, atol=0.03)
    corners = ball.vertices[ball.faces[found.faces]]
    rebuilt = np.einsum("qc,qcd->qd", found.barycentric, corners)
    np.testing.assert_allclose(rebuilt, found.points, atol=1e-9)


def test_a_triangle_without_area_gives_its_nearest_corner() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 0], [5, 5, 5], [6, 5, 5], [5, 6, 5]])
    found = closest_points(np.array([[0.9, 0.1, 0.0]]), vertices, np.array([[0, 1, 2], [3, 4, 5]]))
    assert found.faces[0] == 0
    np.testing.assert_allclose(found.barycentric.sum(), 1)
    assert np.isfinite(found.barycentric).all()

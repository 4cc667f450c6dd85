"""S3M's parts against known answers."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.distance import cdist

from ssm_pipeline.baselines.s3m.augmentation import bumped, rotated_about_z
from ssm_pipeline.baselines.s3m.farthest_points import farthest_points
from ssm_pipeline.baselines.s3m.least_squares_map import functional_maps, nearest_in_spectrum
from ssm_pipeline.baselines.s3m.losses import (
    eigenvector_products,
    multiplication_operators,
    pair_losses,
)
from ssm_pipeline.baselines.s3m.network import FeatureExtractor, TAGConv, knn_graph
from ssm_pipeline.baselines.s3m.product_manifold_filter import filtered_bijection
from ssm_pipeline.baselines.s3m.settings import S3MSettings
from ssm_pipeline.baselines.s3m.spectrum import spectrum
from ssm_pipeline.geometry.surface import area, volume
from ssm_pipeline.records import CaseError, Mesh

CPU = torch.device("cpu")


def sphere(radius: float, subdivisions: int = 3) -> Mesh:
    ball = trimesh.creation.icosphere(subdivisions, radius)
    return Mesh(ball.vertices, ball.faces, "sphere")


def test_farthest_points_of_a_line_halve_it() -> None:
    points = np.zeros((5, 3))
    points[:, 0] = [0, 1, 2, 3, 4]
    assert farthest_points(points, 5, first=0)[:3].tolist() == [0, 4, 2]


def test_farthest_points_do_not_depend_on_the_order_of_the_points() -> None:
    generator = np.random.default_rng(0)
    points = generator.normal(size=(200, 3))
    order = generator.permutation(200)
    chosen = points[farthest_points(points, 40)]
    assert np.array_equal(points[order][farthest_points(points[order], 40)], chosen)


def test_farthest_points_leave_no_hole() -> None:
    # Each point left out lies within the distance at which the last one was taken.
    points = np.random.default_rng(1).normal(size=(300, 3))
    chosen = farthest_points(points, 60)
    between = cdist(points, points[chosen])
    last_step = between[chosen[-1], :-1].min()
    assert between.min(axis=1).max() <= last_step
    with pytest.raises(ValueError, match="301 points requested from 300"):
        farthest_points(points, 301)


def test_spectrum_of_the_sphere() -> None:
    # l(l+1)/r² with multiplicity 2l+1; 642 vertices are within 1 % for l ≤ 2.
    result = spectrum(sphere(50.0), 9)
    expected = np.array([0] + 3 * [2] + 5 * [6]) / 50.0**2
    assert result.eigenvalues == pytest.approx(expected, rel=0.01, abs=1e-9)
    gram = result.eigenvectors.T @ (result.mass[:, None] * result.eigenvectors)
    assert gram == pytest.approx(np.eye(9), abs=1e-10)


def test_spectrum_says_which_mesh_is_too_coarse() -> None:
    coarse = trimesh.creation.icosphere(0)
    with pytest.raises(CaseError, match="case x: the mesh has 12 vertices"):
        spectrum(Mesh(coarse.vertices, coarse.faces, "x"), 20)


def test_rotation_keeps_heights_and_shape() -> None:
    mesh = sphere(10.0)
    turned = rotated_about_z(mesh, 1.1)
    assert turned.vertices[:, 2] == pytest.approx(mesh.vertices[:, 2])
    angle = np.arctan2(turned.vertices[:, 1], turned.vertices[:, 0])
    before = np.arctan2(mesh.vertices[:, 1], mesh.vertices[:, 0])
    off_axis = np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1]) > 1e-6
    assert np.cos(angle - before - 1.1)[off_axis] == pytest.approx(1.0)


def test_a_bump_has_its_height_at_its_centre() -> None:
    mesh = sphere(10.0)
    size = np.sqrt(area(mesh.vertices, mesh.faces))
    offset = np.linalg.norm(
        bumped(mesh, 1, 0.02, 0.1, np.random.default_rng(0)).vertices - mesh.vertices, axis=1
    )
    assert offset.max() == pytest.approx(0.02 * size)
    # One standard deviation away e^-1/2 of it is left.
    distance = np.linalg.norm(mesh.vertices - mesh.vertices[offset.argmax()], axis=1)
    expected = 0.02 * size * np.exp(-((distance / (0.1 * size)) ** 2) / 2)
    assert offset == pytest.approx(expected, abs=1e-12)


def test_bumps_grow_with_the_organ() -> None:
    small, large = (
        bumped(sphere(radius), 3, 0.02, 0.1, np.random.default_rng(2)) for radius in (1.0, 100.0)
    )
    assert large.vertices == pytest.approx(100 * small.vertices)
    assert volume(small.vertices, small.faces) > 0


def test_tag_convolution_is_the_dense_formula() -> None:
    generator = np.random.default_rng(3)
    points = generator.normal(size=(30, 3))
    x = torch.tensor(generator.normal(size=(30, 5)), requires_grad=True)
    layer = TAGConv(5, 4, hops=3).double()
    with torch.no_grad():
        layer.bias.normal_(generator=torch.Generator().manual_seed(0))

    nearest = cdist(points, points).argsort(axis=1)[:, 1:7]
    adjacency = np.zeros((30, 30))
    np.put_along_axis(adjacency, nearest, 1.0, axis=1)
    scale = np.diag(adjacency.sum(axis=1) ** -0.5)
    hop = torch.tensor(scale @ adjacency @ scale)
    W = layer.weight.reshape(4, 5, 4)
    expected = sum(torch.linalg.matrix_power(hop, h) @ x @ W[h] for h in range(4)) + layer.bias

    result = layer(x, knn_graph(points, 6, CPU))
    torch.testing.assert_close(result, expected, rtol=1e-12, atol=1e-12)
    weights = torch.tensor(generator.normal(size=(30, 4)))
    (gradient,) = torch.autograd.grad((result * weights).sum(), x)
    (expected_gradient,) = torch.autograd.grad((expected * weights).sum(), x)
    torch.testing.assert_close(gradient, expected_gradient, rtol=1e-12, atol=1e-12)


def test_points_in_one_place_still_have_all_their_neighbours() -> None:
    points = np.zeros((20, 3))
    points[12:] = np.random.default_rng(4).normal(size=(8, 3))
    graph = knn_graph(points, 5, CPU)
    assert graph.senders.reshape(20, 5).ne(torch.arange(20)[:, None]).all()


def test_descriptors_do_not_depend_on_the_order_of_the_points() -> None:
    generator = np.random.default_rng(5)
    points = generator.normal(size=(60, 3))
    order = generator.permutation(60)
    network = FeatureExtractor(8, torch.Generator().manual_seed(0)).double()
    features = network(torch.tensor(points), knn_graph(points, 4, CPU))
    shuffled = network(torch.tensor(points[order]), knn_graph(points[order], 4, CPU))
    torch.testing.assert_close(shuffled, features[order], rtol=1e-10, atol=1e-10)
    assert torch.linalg.norm(features.detach(), dim=1).numpy() == pytest.approx(np.ones(60))


def test_functional_map_known_answer() -> None:
    generator = torch.Generator().manual_seed(0)
    C = torch.randn(3, 6, 6, generator=generator, dtype=torch.float64)
    A = torch.randn(3, 6, 40, generator=generator, dtype=torch.float64)
    torch.testing.assert_close(functional_maps(A, C @ A), C, rtol=1e-9, atol=1e-9)


def test_functional_map_is_the_least_squares_solution() -> None:
    generator = torch.Generator().manual_seed(1)
    A = torch.randn(2, 1, 6, 40, generator=generator, dtype=torch.float64)
    B = torch.randn(1, 3, 6, 40, generator=generator, dtype=torch.float64)
    expected = torch.linalg.lstsq(
        A.mT.expand(2, 3, 40, 6).contiguous(), B.mT.expand(2, 3, 40, 6).contiguous()
    ).solution.mT
    torch.testing.assert_close(functional_maps(A, B), expected, rtol=1e-9, atol=1e-9)


def test_nearest_in_spectrum_undoes_a_renumbering() -> None:
    generator = np.random.default_rng(6)
    Phi = generator.normal(size=(50, 8))
    C = np.linalg.qr(generator.normal(size=(8, 8)))[0]
    order = generator.permutation(50)
    assert np.array_equal(nearest_in_spectrum(C, Phi, (Phi @ C.T)[order]), order)


def test_multiplication_operator_multiplies() -> None:
    generator = torch.Generator().manual_seed(0)
    f, mass = (torch.rand(7, c, generator=generator, dtype=torch.float64) for c in (3, 1))
    Phi = torch.randn(7, 5, generator=generator, dtype=torch.float64)
    expected = torch.stack([Phi.mT @ torch.diag(mass[:, 0] * f[:, p]) @ Phi for p in range(3)])
    products = eigenvector_products(Phi, mass[:, 0])
    torch.testing.assert_close(multiplication_operators(f, products, 5), expected)


def test_losses_vanish_for_the_right_map_and_only_there() -> None:
    generator = torch.Generator().manual_seed(2)
    k = 5
    settings = S3MSettings()
    rotation = torch.linalg.qr(torch.randn(k, k, generator=generator))[0][None, None]
    operators = torch.randn(1, 3, k, k, generator=generator)
    rotated = rotation[0] @ operators @ rotation[0].mT
    equal = torch.full((1, k), 2.0)  # a rotation commutes with equal eigenvalues only
    right = pair_losses(rotation, rotation.mT, equal, equal, operators, rotated, settings)
    assert right.item() == pytest.approx(0, abs=1e-9)
    wrong = pair_losses(rotation.mT, rotation, equal, equal, operators, rotated, settings)
    assert wrong.item() > 1

    values = torch.arange(k, dtype=torch.float32)[None]
    # Each term by hand for C = 2 I: bijectivity and orthogonality mean((3 I)²) = 9/k, none for
    # the Laplacian; preservation 0 for equal operators.
    twice = 2 * torch.eye(k)[None, None]
    doubled = pair_losses(twice, twice, values, values, operators, operators, settings)
    assert doubled.item() == pytest.approx(2 * 9 / k)
    # C = I between shapes whose eigenvalues differ by 1: the Laplacian term is mean(I²) = 1/k.
    one = torch.eye(k)[None, None]
    shifted = pair_losses(one, one, values, values + 1, operators, operators, settings)
    assert shifted.item() == pytest.approx(1e-3 / k)
    # … and operators that differ by I: 100/k.
    moved = pair_losses(one, one, values, values, operators, operators + one, settings)
    assert moved.item() == pytest.approx(100 / k, rel=1e-5)


def test_the_laplacian_term_commutes_the_map_with_both_spectra() -> None:
    settings = S3MSettings(bijectivity=0, orthogonality=0, laplacian=1, preservation=0)
    generator = np.random.default_rng(4)
    C, k = generator.standard_normal((5, 5)), 5  # not symmetric
    x, y = np.sort(generator.uniform(0, 9, (2, k)), axis=1)
    operators = torch.zeros(1, 2, k, k)
    found = pair_losses(
        torch.as_tensor(C.astype(np.float32))[None],
        torch.as_tensor(C.astype(np.float32))[None],
        torch.as_tensor(x.astype(np.float32))[None],
        torch.as_tensor(y.astype(np.float32))[None],
        operators,
        operators,
        settings,
    )
    expected = ((C @ np.diag(x) - np.diag(y) @ C) ** 2).mean()
    assert found.item() == pytest.approx(expected, rel=1e-5)


def test_filter_keeps_a_perfect_map_and_repairs_a_noised_one() -> None:
    generator = np.random.default_rng(7)
    mesh = sphere(1.0, 2)
    points = mesh.vertices  # 162 points; great-circle distances
    geodesic = np.arccos(np.clip(points @ points.T, -1, 1))
    order = generator.permutation(len(points))
    geodesic_y = geodesic[np.ix_(order, order)]
    std = 0.2
    assert np.array_equal(filtered_bijection(order, geodesic / std, geodesic_y / std), order)

    noised = order.copy()
    wrong = generator.choice(len(points), len(points) // 4, replace=False)
    noised[wrong] = generator.integers(0, len(points), len(wrong))
    repaired = filtered_bijection(noised, geodesic / std, geodesic_y / std)
    assert np.array_equal(np.sort(repaired), np.arange(len(points)))
    error = geodesic[noised, order].mean()
    assert geodesic[repaired, order].mean() < 0.5 * error
    with pytest.raises(ValueError, match="as many points"):
        filtered_bijection(order, geodesic, geodesic_y[:10, :10])

import numpy as np
import pytest
from shapes import basis_of, blob, sphere

from ssm_pipeline.geometry.surface import vertex_normals
from ssm_pipeline.records import CaseError, Mesh
from ssm_pipeline.spectral.basis import spectral_basis
from ssm_pipeline.spectral.settings import SpectralSettings
from ssm_pipeline.spectral.wave_kernel import wave_kernel_signature


def test_sphere_spectrum_is_l_times_l_plus_one() -> None:
    basis = basis_of(sphere(radius=40.0, subdivisions=4), eigenpairs=25)
    # At unit area r² = 1 / 4π, whatever the radius was.
    expected = np.repeat([0, 2, 6, 12, 20], [1, 3, 5, 7, 9]) * 4 * np.pi
    # Linear elements at 2562 vertices: second order in the edge length, 0.9 % at l = 4.
    np.testing.assert_allclose(basis.eigenvalues, expected, rtol=0.01, atol=1e-6)


def test_sphere_spectrum_converges() -> None:
    errors = [
        abs(basis_of(sphere(subdivisions=s), 10).eigenvalues[4] - 6 * 4 * np.pi) for s in (2, 3, 4)
    ]
    assert errors[0] > 3 * errors[1] > 9 * errors[2]


def test_flat_ellipsoid_knows_its_long_axis() -> None:
    ball = sphere(subdivisions=4)
    basis = basis_of(Mesh(ball.vertices * [1, 1, 3], ball.faces, "ellipsoid"), 5)
    first = basis.eigenvectors[:, 1]
    # The slowest oscillation runs along the longest axis.
    assert abs(np.corrcoef(first, basis.vertices[:, 2])[0, 1]) > 0.98
    assert basis.eigenvalues[1] < 0.5 * basis.eigenvalues[2]


def test_eigenvectors_are_mass_orthonormal_and_solve_the_problem() -> None:
    basis = basis_of(blob(1), 30)
    Phi, M = basis.eigenvectors, basis.mass[:, None]
    np.testing.assert_allclose(Phi.T @ (M * Phi), np.eye(30), atol=1e-8)
    residual = basis.laplacian @ Phi - M * Phi * basis.eigenvalues
    assert np.abs(residual).max() < 1e-6 * basis.eigenvalues[-1]
    assert basis.mass.sum() == pytest.approx(1, abs=1e-9)


def test_basis_does_not_see_position_size_or_numbering() -> None:
    mesh = blob(2)
    order = np.random.default_rng(0).permutation(len(mesh.vertices))
    rank = np.argsort(order)
    moved = Mesh(7.5 * mesh.vertices[order] + [100, -50, 3], rank[mesh.faces], "moved")
    a, b = basis_of(mesh), basis_of(moved)
    np.testing.assert_allclose(a.eigenvalues, b.eigenvalues, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(b.frame.apply(b.vertices), moved.vertices, atol=1e-9)
    wks_a, wks_b = (wave_kernel_signature(s.eigenvalues, s.eigenvectors, 32) for s in (a, b))
    np.testing.assert_allclose(wks_a[order], wks_b, rtol=1e-4, atol=1e-5)


def test_gradient_of_a_linear_function_is_its_tangential_part() -> None:
    basis = basis_of(sphere(subdivisions=4), 5)
    direction = np.array([0.3, -0.5, 0.8])
    f = basis.vertices @ direction
    length = np.hypot(basis.gradient_x @ f, basis.gradient_y @ f)
    normals = vertex_normals(basis.vertices, basis.faces)
    tangential = np.linalg.norm(direction - (normals @ direction)[:, None] * normals, axis=1)
    # First-order stencil; an edge spans about 0.04 of the radius here.
    np.testing.assert_allclose(length, tangential, atol=0.03)


def test_gradient_of_a_constant_is_zero() -> None:
    basis = basis_of(blob(3), 5)
    one = np.ones(len(basis.vertices))
    assert np.abs(basis.gradient_x @ one).max() < 1e-9


def test_wave_kernel_matches_the_plain_sum() -> None:
    basis = basis_of(blob(1), 12)
    wks = wave_kernel_signature(basis.eigenvalues, basis.eigenvectors, 6)
    logs = np.log(basis.eigenvalues[1:])
    energies = np.linspace(logs[0], logs[-1] / 1.02, 6)
    sigma = 7 * (energies[1] - energies[0])
    for e, energy in enumerate(energies):
        weight = [np.exp(-((energy - log) ** 2) / (2 * sigma**2)) for log in logs]
        plain = sum(w * basis.eigenvectors[:, k + 1] ** 2 for k, w in enumerate(weight)) / sum(
            weight
        )
        np.testing.assert_allclose(wks[:, e], plain, rtol=1e-10)


def test_too_few_vertices_names_the_case() -> None:
    with pytest.raises(CaseError, match=r"case sphere: .*42 vertices.*200.*meshing\.faces"):
        spectral_basis(sphere(subdivisions=1), SpectralSettings(eigenpairs=100))

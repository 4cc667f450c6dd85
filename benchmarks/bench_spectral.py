"""Spectral operators of one mesh: the project's against the plain way of each step.

    python benchmarks/bench_spectral.py [--vertices 4000] [--eigenpairs 200]

Plain: eigenpairs of the generalised problem by scipy's shift-invert, gradients by a least squares
solve a vertex, the wave kernel energy by energy. Prints seconds, the largest difference between
the results, and the ratio.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np
import scipy.sparse as sp
from bench_training import solid
from scipy.sparse.linalg import eigsh

from ssm_pipeline.geometry.surface import vertex_normals
from ssm_pipeline.spectral.basis import smallest_eigenpairs, spectral_basis
from ssm_pipeline.spectral.gradients import gradient_operators, one_ring_edges
from ssm_pipeline.spectral.settings import SpectralSettings
from ssm_pipeline.spectral.wave_kernel import wave_kernel_signature

Result = TypeVar("Result")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vertices", type=int, default=4000)
    parser.add_argument("--eigenpairs", type=int, default=200)
    arguments = parser.parse_args()
    k = arguments.eigenpairs
    mesh = solid(1, arguments.vertices)
    basis, whole = timed(lambda: spectral_basis(mesh, SpectralSettings(eigenpairs=k)))
    print(f"{len(mesh.vertices)} vertices, k = {k}: all operators {whole:.2f} s")

    (values, _), fast = timed(lambda: smallest_eigenpairs(basis.laplacian, basis.mass, k))
    mass = sp.diags(basis.mass)
    plain_values, plain = timed(
        lambda: np.sort(eigsh(basis.laplacian, k, M=mass, sigma=-1e-8, return_eigenvectors=False))
    )
    report("eigenpairs", fast, plain, np.abs(values - plain_values).max() / values[-1])

    (gradient, _), fast = timed(lambda: gradient_operators(basis.vertices, basis.faces))
    slow, plain = timed(lambda: plain_gradient_lengths(basis.vertices, basis.faces))
    f = basis.vertices[:, 0]
    own = np.hypot(basis.gradient_x @ f, basis.gradient_y @ f)
    report("gradients", fast, plain, np.abs(own - slow).max())
    assert gradient.shape == (len(f), len(f))

    wks, fast = timed(lambda: wave_kernel_signature(basis.eigenvalues, basis.eigenvectors))
    slow, plain = timed(lambda: plain_wave_kernel(basis.eigenvalues, basis.eigenvectors))
    report("wave kernel", fast, plain, np.abs(wks - slow).max())


def report(step: str, fast: float, plain: float, difference: float) -> None:
    print(
        f"{step:<12} {fast:7.3f} s   plain {plain:7.3f} s   ratio {plain / fast:6.1f}   "
        f"largest difference {difference:.1e}"
    )


def timed(work: Callable[[], Result]) -> tuple[Result, float]:
    work()
    start = time.perf_counter()
    result = work()
    return result, time.perf_counter() - start


def plain_gradient_lengths(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """|gradient| of the first coordinate: a regularised least squares problem a vertex."""
    normals, f = vertex_normals(vertices, faces), vertices[:, 0]
    start, end = one_ring_edges(faces).T
    bounds = np.searchsorted(start, np.arange(len(vertices) + 1))
    lengths = np.empty(len(vertices))
    for i, normal in enumerate(normals):
        ring = end[bounds[i] : bounds[i + 1]]
        frame = np.linalg.svd(normal[None])[2][1:]
        edges = vertices[ring] - vertices[i]
        flat = edges @ frame.T
        flat *= (np.linalg.norm(edges, axis=1) / np.linalg.norm(flat, axis=1))[:, None]
        gram = flat.T @ flat
        gram += 1e-5 * 0.5 * np.trace(gram) * np.eye(2)
        lengths[i] = np.linalg.norm(np.linalg.solve(gram, flat.T @ (f[ring] - f[i])))
    return lengths


def plain_wave_kernel(values: np.ndarray, vectors: np.ndarray, count: int = 128) -> np.ndarray:
    logs = np.log(values[1:])
    energies = np.linspace(logs[0], logs[-1] / 1.02, count)
    sigma = 7 * (energies[1] - energies[0])
    columns = []
    for energy in energies:
        weights = np.exp(-((energy - logs) ** 2) / (2 * sigma**2))
        total = np.zeros(len(vectors))
        for weight, vector in zip(weights, vectors[:, 1:].T, strict=True):
            total += weight * vector**2
        columns.append(total / weights.sum())
    return np.stack(columns, axis=1)


if __name__ == "__main__":
    main()

"""The wave kernel signature."""

from __future__ import annotations

import numpy as np


def wave_kernel_signature(
    eigenvalues: np.ndarray, eigenvectors: np.ndarray, count: int = 128
) -> np.ndarray:
    """(V, count): the chance of finding a quantum particle of each energy at each vertex.

    eigenvalues (K,) ascending, eigenvectors (V, K). One matrix product: squared eigenvectors
    times log-normal weights. Source: Aubry, Schlickewei, Cremers 2011, section 4, with their
    variance of seven energy steps.
    """
    positive = eigenvalues > 1e-6 * eigenvalues[-1]  # the constant function carries no energy
    log_values = np.log(eigenvalues[positive])
    energies = np.linspace(log_values[0], log_values[-1] / 1.02, count)
    sigma = 7 * abs(energies[1] - energies[0])
    weights = np.exp(-((energies[None, :] - log_values[:, None]) ** 2) / (2 * sigma**2))
    result: np.ndarray = eigenvectors[:, positive] ** 2 @ (weights / weights.sum(axis=0))
    return result

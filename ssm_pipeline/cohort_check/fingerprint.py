"""Numbers of one mesh that don't depend on where it lies: size, compactness, spectrum."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import robust_laplacian

from ssm_pipeline.geometry.surface import area, volume
from ssm_pipeline.records import Mesh
from ssm_pipeline.spectral.basis import smallest_eigenpairs

EIGENVALUES = 12  # past the constant one: the organ's build, not yet its details
TYPICAL = 3  # cases that all others are fitted to


def fingerprint(mesh: Mesh) -> dict[str, float]:
    """volume_ml, area_cm2, compactness and the Laplacian's eigenvalues `eigenvalue_<k>`.

    compactness  36 π V² / A³: 1 for a ball, 0.52 for a cube, near 0 for a plate.
    eigenvalues  times the area, so that size does not count: 8π ≈ 25.1 for a ball's first.

    >>> import trimesh
    >>> ball = trimesh.creation.icosphere(3)
    >>> numbers = fingerprint(Mesh(10 * ball.vertices, ball.faces, "ball"))
    >>> round(numbers["compactness"], 2), round(numbers["eigenvalue_1"])
    (1.0, 25)
    """
    surface = area(mesh.vertices, mesh.faces)
    enclosed = volume(mesh.vertices, mesh.faces)
    laplacian, mass = robust_laplacian.mesh_laplacian(mesh.vertices / np.sqrt(surface), mesh.faces)
    eigenvalues, _ = smallest_eigenpairs(laplacian, mass.diagonal(), EIGENVALUES + 1)
    return {
        "volume_ml": enclosed / 1000,
        "area_cm2": surface / 100,
        "compactness": 36 * np.pi * enclosed**2 / surface**3,
    } | {f"eigenvalue_{k}": float(value) for k, value in enumerate(eigenvalues[1:], start=1)}


def log_spectra(table: pd.DataFrame) -> np.ndarray:
    """(N, EIGENVALUES): logarithms of the eigenvalues of a table of fingerprints."""
    columns = [f"eigenvalue_{k}" for k in range(1, EIGENVALUES + 1)]
    result: np.ndarray = np.log(table[columns].to_numpy(float))
    return result


def typical_cases(case_ids: Sequence[str], table: pd.DataFrame) -> tuple[str, ...]:
    """The few cases nearest to the cohort's median in size, compactness and spectrum.

    Args:
        table: A row of fingerprint numbers per case, in the order of case_ids.
    """
    sizes = np.log(table[["volume_ml", "compactness"]].to_numpy(float))
    features = np.hstack([sizes, log_spectra(table)])
    away = np.abs(features - np.median(features, axis=0))
    spread = np.maximum(np.median(away, axis=0), 1e-6)
    order = np.argsort((away / spread).mean(axis=1), kind="stable")
    return tuple(case_ids[index] for index in order[:TYPICAL])

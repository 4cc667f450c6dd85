"""A shape as the networks see it: the spectral basis on a device."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import torch

from ssm_pipeline.matching.settings import MatchingSettings
from ssm_pipeline.matching.sparse import SparseMatrix
from ssm_pipeline.records import SpectralBasis
from ssm_pipeline.spectral.wave_kernel import wave_kernel_signature

COORDINATE_SCALE = 3.0  # as network input: they span about ±0.3 at unit area, the signature about 1


@dataclass(frozen=True, eq=False)
class Shape:
    """Tensors of one shape, unit area: vertices (V, 3), mass (V,), eigenvalues (K,),
    eigenvectors Φ (V, K), projection Φ† = ΦᵀA (K, V), inputs (V, D) of the feature network,
    gradients (2V, V) with the x rows above the y rows, laplacian (V, V);
    edges (E, 2) directed and their cotangent weights (E,); neighbours (V, R), the one-ring padded
    with the vertex itself.
    """

    case_id: str
    vertices: torch.Tensor
    mass: torch.Tensor
    eigenvalues: torch.Tensor
    eigenvectors: torch.Tensor
    projection: torch.Tensor
    inputs: torch.Tensor
    gradients: SparseMatrix
    laplacian: SparseMatrix
    edges: torch.Tensor
    edge_weights: torch.Tensor
    neighbours: torch.Tensor


def input_channels(settings: MatchingSettings) -> int:
    return settings.descriptors + (3 if settings.features == "xyz+wks" else 0)


def network_inputs(
    vertices: np.ndarray,
    eigenvalues: np.ndarray,
    eigenvectors: np.ndarray,
    settings: MatchingSettings,
) -> np.ndarray:
    """The inputs of the feature network: the wave kernel signature, and coordinates if set.

    Args:
        vertices: `(V, 3)`, unit area.
        eigenvalues: `(K,)`, ascending.
        eigenvectors: `(V, K)`.
        settings: Which inputs, and how many descriptors.

    Returns:
        `(V, D)`.
    """
    descriptors = wave_kernel_signature(eigenvalues, eigenvectors, settings.descriptors)
    if settings.features == "xyz+wks":
        return np.concatenate([COORDINATE_SCALE * vertices, descriptors], axis=1)
    return descriptors


def to_shape(
    basis: SpectralBasis,
    settings: MatchingSettings,
    device: torch.device | str = "cpu",
    dtype: torch.dtype = torch.float32,
) -> Shape:
    """Put a spectral basis on a device, with the feature network's inputs."""
    device = torch.device(device)

    def tensor(array: np.ndarray) -> torch.Tensor:
        return torch.as_tensor(np.ascontiguousarray(array), dtype=dtype, device=device)

    inputs = network_inputs(basis.vertices, basis.eigenvalues, basis.eigenvectors, settings)
    edges, weights = _weighted_edges(basis.laplacian)
    return Shape(
        case_id=basis.case_id,
        vertices=tensor(basis.vertices),
        mass=tensor(basis.mass),
        eigenvalues=tensor(basis.eigenvalues),
        eigenvectors=tensor(basis.eigenvectors),
        projection=tensor((basis.eigenvectors * basis.mass[:, None]).T),
        inputs=tensor(inputs),
        gradients=SparseMatrix(sp.vstack([basis.gradient_x, basis.gradient_y]), device, dtype),
        laplacian=SparseMatrix(basis.laplacian, device, dtype),
        edges=torch.as_tensor(edges, device=device),
        edge_weights=tensor(weights),
        neighbours=torch.as_tensor(_padded_ring(edges, len(basis.vertices)), device=device),
    )


def _weighted_edges(laplacian: sp.csr_matrix) -> tuple[np.ndarray, np.ndarray]:
    """Edges of the intrinsic Delaunay triangulation, both directions, sorted by their start."""
    entries = laplacian.tocoo()
    off_diagonal = entries.row != entries.col
    edges = np.stack([entries.row, entries.col], axis=1)[off_diagonal].astype(np.int64)
    weights = np.maximum(-entries.data[off_diagonal], 0)
    order = np.lexsort(edges.T[::-1])
    return edges[order], weights[order]


def _padded_ring(edges: np.ndarray, count: int) -> np.ndarray:
    """(V, R) one-ring neighbours, R the largest valence; short rings repeat the vertex itself."""
    start, end = edges.T
    valence = np.bincount(start, minlength=count)
    position = np.arange(len(edges)) - np.repeat(np.cumsum(valence) - valence, valence)
    ring = np.repeat(np.arange(count)[:, None], valence.max(), axis=1)
    ring[start, position] = end
    return ring

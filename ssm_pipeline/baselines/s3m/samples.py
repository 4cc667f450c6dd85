"""A shape as S3M's network sees it: sampled points, their graph and the eigenfunctions on them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ssm_pipeline.baselines.s3m.augmentation import bumped, rotated_about_z
from ssm_pipeline.baselines.s3m.farthest_points import farthest_points
from ssm_pipeline.baselines.s3m.losses import eigenvector_products
from ssm_pipeline.baselines.s3m.network import Graph, knn_graph
from ssm_pipeline.baselines.s3m.settings import S3MSettings
from ssm_pipeline.baselines.s3m.spectrum import Spectrum, spectrum
from ssm_pipeline.records import Mesh


@dataclass(frozen=True, eq=False)
class Sample:
    """vertices (n,) int of the mesh, and on them: points (n, 3), centred; their graph;
    eigenvectors (n, k) and their products (`losses.eigenvector_products`); projection (k, n) =
    Φᵀ · mass; eigenvalues (k,). Tensors float32."""

    vertices: np.ndarray
    points: torch.Tensor
    graph: Graph
    eigenvectors: torch.Tensor
    products: torch.Tensor
    projection: torch.Tensor
    eigenvalues: torch.Tensor


@dataclass(frozen=True, eq=False)
class TrainingCopy:
    """A shape or augmented shape, and the dense points (D,) int that its samples are drawn from."""

    mesh: Mesh
    basis: Spectrum
    dense: np.ndarray


def inference_sample(mesh: Mesh, settings: S3MSettings, device: torch.device) -> Sample:
    """The farthest-point sample that S3M puts into correspondence."""
    chosen = farthest_points(mesh.vertices, settings.points)
    return _sample(mesh, spectrum(mesh, settings.eigenfunctions), chosen, settings, device)


def training_copies(
    mesh: Mesh, settings: S3MSettings, generator: np.random.Generator
) -> list[TrainingCopy]:
    """The mesh and its augmented copies."""
    own = spectrum(mesh, settings.eigenfunctions)
    copies = [(mesh, own)]
    for _ in range(settings.rotated_copies):  # an isometry: the spectrum stays
        copies.append((rotated_about_z(mesh, generator.uniform(0, 2 * np.pi)), own))
    for _ in range(settings.bumped_copies):
        copy = bumped(mesh, settings.bumps, settings.bump_height, settings.bump_std, generator)
        copies.append((copy, spectrum(copy, settings.eigenfunctions)))
    count = min(settings.dense_points, len(mesh.vertices))
    return [
        TrainingCopy(copy, basis, farthest_points(copy.vertices, count)) for copy, basis in copies
    ]


def drawn_sample(
    copy: TrainingCopy,
    settings: S3MSettings,
    generator: np.random.Generator,
    device: torch.device,
) -> Sample:
    """A farthest-point sample of the dense points, from a first one drawn at random."""
    first = int(generator.integers(len(copy.dense)))
    subset = farthest_points(copy.mesh.vertices[copy.dense], settings.points, first)
    return _sample(copy.mesh, copy.basis, copy.dense[subset], settings, device)


def scaled(mesh: Mesh, factor: float) -> Mesh:
    return dataclasses.replace(mesh, vertices=mesh.vertices * factor)


def stacked(samples: Sequence[Sample], name: str) -> torch.Tensor:
    """One field of several samples, (B, …)."""
    return torch.stack([getattr(sample, name) for sample in samples])


def _sample(
    mesh: Mesh, basis: Spectrum, chosen: np.ndarray, settings: S3MSettings, device: torch.device
) -> Sample:
    def tensor(values: np.ndarray) -> torch.Tensor:
        return torch.as_tensor(np.ascontiguousarray(values), dtype=torch.float32, device=device)

    points = mesh.vertices[chosen]
    eigenvectors, mass = tensor(basis.eigenvectors[chosen]), tensor(basis.mass[chosen])
    return Sample(
        vertices=chosen,
        points=tensor(points - mesh.vertices.mean(axis=0)),
        graph=knn_graph(points, settings.neighbours, device),
        eigenvectors=eigenvectors,
        products=eigenvector_products(eigenvectors, mass),
        projection=(eigenvectors * mass[:, None]).T.contiguous(),
        eigenvalues=tensor(basis.eigenvalues),
    )

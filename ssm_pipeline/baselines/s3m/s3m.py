"""S3M, an unsupervised statistical shape model by functional maps: the baseline, end to end.

Source: Bastian et al. 2023, "S3M: Scalable Statistical Shape Modeling through Unsupervised
Correspondences", MICCAI. Written from its description. Two defects of its public code are not
copied: shapes after the reference in the list kept uninitialised correspondences, and its metric
was not in millimetres (metrics are not this module's business).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import joblib
import numpy as np
import torch

from ssm_pipeline.baselines.s3m.epochs import (
    S3MCheckpoint,
    descriptor_operators,
    descriptors,
    new_network,
    random_descriptors,
    train_extractor,
)
from ssm_pipeline.baselines.s3m.joined_points import joining_faces
from ssm_pipeline.baselines.s3m.least_squares_map import functional_maps, nearest_in_spectrum
from ssm_pipeline.baselines.s3m.losses import pair_losses
from ssm_pipeline.baselines.s3m.network import FeatureExtractor
from ssm_pipeline.baselines.s3m.product_manifold_filter import filtered_bijection
from ssm_pipeline.baselines.s3m.samples import (
    Sample,
    TrainingCopy,
    inference_sample,
    scaled,
    stacked,
    training_copies,
)
from ssm_pipeline.baselines.s3m.settings import S3MSettings
from ssm_pipeline.geometry.geodesics import geodesics_from
from ssm_pipeline.geometry.surface import area
from ssm_pipeline.parallel import in_processes
from ssm_pipeline.records import CaseError, CorrespondedShapes, Mesh, StudyError

Progress = Callable[[str, int, int], None]  # what is being done, how many done, of how many


@dataclass(frozen=True, eq=False)
class S3MMatch:
    """What S3M leaves.

    template_losses (N,) each case's mean loss to all others; the lowest is the reference.

    Attributes:
        points: Vertices (N, n, 3) mm, each case's own vertices in its own space, in the order of
            the template's sample, joined by the faces of `surface.joining_faces`.
    """

    points: CorrespondedShapes
    template_losses: np.ndarray

    @property
    def template_id(self) -> str:
        return self.points.template_id


def train_s3m(
    meshes: Sequence[Mesh],
    settings: S3MSettings,
    seed: int,
    device: torch.device,
    on_progress: Progress,
    start: S3MCheckpoint | None = None,
    on_epoch: Callable[[S3MCheckpoint], None] = lambda checkpoint: None,
) -> S3MCheckpoint:
    """Train S3M's network on the meshes, from a checkpoint where there is one.

    Raises:
        StudyError: For fewer than two meshes.
        CaseError: For a mesh with fewer vertices than the requested points.
    """
    inputs = _inputs(meshes, settings)
    generator = np.random.default_rng(seed)
    copies: list[TrainingCopy] = []
    for done, mesh in enumerate(inputs, 1):
        copies += training_copies(mesh, settings, generator)
        on_progress("sample", done, len(meshes))
    return train_extractor(
        copies,
        settings,
        seed,
        device,
        lambda done, of: on_progress("train", done, of),
        start,
        on_epoch,
    )


def match_s3m(
    meshes: Sequence[Mesh],
    trained: S3MCheckpoint,
    settings: S3MSettings,
    seed: int,
    device: torch.device,
    on_progress: Progress,
    seen: Collection[str] | None = None,
    jobs: int = 1,
) -> S3MMatch:
    """Put the meshes into correspondence by a trained network.

    Raises as `train_s3m`, and CaseError for a mesh that is not in one piece.

    Args:
        seen: The cases that the reference is chosen among; None: all.
        jobs: Processes, a case each at a time; the result does not depend on it.
    """
    inputs = _inputs(meshes, settings)
    network = new_network(settings, seed)
    network.load_state_dict(trained.network)
    samples = [inference_sample(mesh, settings, device) for mesh in inputs]
    chosen = random_descriptors(settings, np.random.default_rng(seed))
    among = np.array([seen is None or mesh.case_id in seen for mesh in meshes])
    C, template_losses = _all_maps(network.to(device), samples, settings, chosen, among)
    template = int(np.where(among, template_losses, np.inf).argmin())
    points = np.empty((len(meshes), settings.points, 3))
    stds = _kernel_stds(meshes, settings)
    template_geodesics = _geodesics(meshes[template], samples[template].vertices) / stds[template]
    eigenvectors = [sample.eigenvectors.cpu().numpy() for sample in samples]
    tasks = (
        joblib.delayed(_order_of_template)(
            nearest_in_spectrum(C[template, case], eigenvectors[template], eigenvectors[case]),
            template_geodesics,
            mesh,
            samples[case].vertices,
            stds[case],
        )
        for case, mesh in enumerate(meshes)
    )
    for case, case_to_template in enumerate(in_processes(tasks, jobs)):
        points[case, case_to_template] = meshes[case].vertices[samples[case].vertices]
        on_progress("match", case + 1, len(meshes))
    shapes = CorrespondedShapes(
        points,
        joining_faces(meshes[template], samples[template].vertices),
        tuple(mesh.case_id for mesh in meshes),
        meshes[template].case_id,
    )
    return S3MMatch(shapes, template_losses)


def _inputs(meshes: Sequence[Mesh], settings: S3MSettings) -> list[Mesh]:
    """The meshes as the network sees them. Raises StudyError and CaseError."""
    if len(meshes) < 2:
        raise StudyError(f"S3M needs at least 2 cases; {len(meshes)} given. Add cases.")
    for mesh in meshes:
        if len(mesh.vertices) < settings.points:
            raise CaseError(
                mesh.case_id,
                f"the mesh has {len(mesh.vertices)} vertices; S3M samples {settings.points} of "
                "them. Mesh the case more finely, or set fewer points.",
            )
    if not settings.one_size:
        return list(meshes)
    sizes = _sizes(meshes)
    return [scaled(mesh, sizes.mean() / size) for mesh, size in zip(meshes, sizes, strict=True)]


@torch.no_grad()
def _all_maps(
    network: FeatureExtractor,
    samples: Sequence[Sample],
    settings: S3MSettings,
    chosen: np.ndarray,
    among: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """(N, N, k, k) maps from the first to the second shape; (N,) each shape's mean loss.

    Args:
        chosen: The descriptors that the preservation term looks at; among (N,) bool: the shapes
            that the mean is over.
    """
    features = [descriptors(network, [sample])[0] for sample in samples]
    coefficients = torch.stack(
        [sample.projection @ F for sample, F in zip(samples, features, strict=True)]
    )
    C = functional_maps(coefficients[:, None], coefficients[None, :])
    operators = torch.cat(
        [
            descriptor_operators(F[None], [sample], chosen)
            for sample, F in zip(samples, features, strict=True)
        ]
    )
    values = stacked(samples, "eigenvalues")
    one_way = torch.stack(  # row by row: all pairs' preservation terms at once fill the memory
        [
            pair_losses(C[x], C[:, x], values[x], values, operators[x], operators, settings)
            for x in range(len(samples))
        ]
    )
    losses = (one_way + one_way.T)[:, torch.as_tensor(among)].mean(dim=1)
    return C.cpu().numpy(), losses.cpu().numpy()


def _sizes(meshes: Sequence[Mesh]) -> np.ndarray:
    """(N,) mm: √area of each."""
    return np.sqrt([area(mesh.vertices, mesh.faces) for mesh in meshes])


def _kernel_stds(meshes: Sequence[Mesh], settings: S3MSettings) -> np.ndarray:
    """(N,) mm, the filter's kernel on each case."""
    if settings.kernel_std_share is None:
        return np.full(len(meshes), np.sqrt(settings.kernel_variance_mm2))
    return settings.kernel_std_share * _sizes(meshes)


def _order_of_template(
    case_to_template: np.ndarray,
    template_geodesics: np.ndarray,
    mesh: Mesh,
    sampled: np.ndarray,
    kernel_std: float,
) -> np.ndarray:
    """(n,) the template's point of each sampled vertex: a bijection, of any map."""
    geodesics = _geodesics(mesh, sampled) / kernel_std
    return filtered_bijection(case_to_template, template_geodesics, geodesics)


def _geodesics(mesh: Mesh, sampled: np.ndarray) -> np.ndarray:
    """(n, n) mm between the sampled vertices, along the surface."""
    between = geodesics_from(mesh.vertices, mesh.faces, sampled)[:, sampled]
    if not np.isfinite(between).all():
        raise CaseError(
            mesh.case_id,
            "the surface is in several pieces; S3M needs one. Keep the largest component.",
        )
    return between

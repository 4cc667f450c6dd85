"""S3M, an unsupervised statistical shape model by functional maps: the baseline, end to end.

Source: Bastian et al. 2023, "S3M: Scalable Statistical Shape Modeling through Unsupervised
Correspondences", MICCAI. Written from its description. Two defects of its public code are not
copied: shapes after the reference in the list kept uninitialised correspondences, and its metric
was not in millimetres (metrics are not this module's business).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ssm_pipeline.baselines.s3m.functional_map import functional_maps, nearest_in_spectrum
from ssm_pipeline.baselines.s3m.losses import multiplication_operators, pair_losses
from ssm_pipeline.baselines.s3m.network import FeatureExtractor
from ssm_pipeline.baselines.s3m.product_manifold_filter import filtered_bijection
from ssm_pipeline.baselines.s3m.samples import (
    Sample,
    inference_sample,
    scaled,
    stacked,
    training_samples,
)
from ssm_pipeline.baselines.s3m.settings import S3MSettings
from ssm_pipeline.baselines.s3m.surface import joining_faces
from ssm_pipeline.baselines.s3m.training import descriptors, random_descriptors, train
from ssm_pipeline.geometry.geodesics import geodesics_from
from ssm_pipeline.geometry.surface import area
from ssm_pipeline.records import CaseError, CorrespondedShapes, Mesh, StudyError

Progress = Callable[[str, int, int], None]  # what is being done, how many done, of how many


@dataclass(frozen=True)
class S3MResult:
    """What S3M leaves.

    points          vertices (N, n, 3) mm, each case's own vertices in its own space, in the order
                    of the template's sample, joined by the faces of `surface.joining_faces`.
    template_id     the reference: the case of lowest mean loss.
    epoch_losses    (epochs,) mean training loss.
    template_losses (N,) each case's mean loss to all others, from which the reference was chosen.
    """

    points: CorrespondedShapes
    template_id: str
    epoch_losses: np.ndarray
    template_losses: np.ndarray


def run_s3m(
    meshes: Sequence[Mesh],
    settings: S3MSettings,
    seed: int,
    device: torch.device,
    on_progress: Progress,
) -> S3MResult:
    """Train S3M on the meshes and put them into correspondence.

    Raises StudyError for fewer than two meshes, CaseError for a mesh with fewer vertices than the
    points asked for or not in one piece.
    """
    if len(meshes) < 2:
        raise StudyError(f"S3M needs at least 2 cases; {len(meshes)} given. Add cases.")
    for mesh in meshes:
        if len(mesh.vertices) < settings.points:
            raise CaseError(
                mesh.case_id,
                f"the mesh has {len(mesh.vertices)} vertices; S3M samples {settings.points} of "
                "them. Mesh the case more finely, or set fewer points.",
            )
    sizes = np.sqrt([area(mesh.vertices, mesh.faces) for mesh in meshes])
    factors = sizes.mean() / sizes if settings.one_size else np.ones(len(meshes))
    inputs = [scaled(mesh, factor) for mesh, factor in zip(meshes, factors, strict=True)]

    numpy_generator = np.random.default_rng(seed)
    generator = torch.Generator().manual_seed(seed)
    copies: list[list[Sample]] = []
    for done, mesh in enumerate(inputs, 1):
        copies += training_samples(mesh, settings, numpy_generator, device)
        on_progress("sample", done, len(meshes))
    network, losses = train(
        copies, settings, generator, device, lambda done, of: on_progress("train", done, of)
    )

    samples = [inference_sample(mesh, settings, device) for mesh in inputs]
    C, template_losses = _all_maps(network, samples, settings, generator)
    template = int(template_losses.argmin())
    points = np.empty((len(meshes), settings.points, 3))
    stds = _kernel_stds(sizes, settings)
    template_geodesics = _geodesics(meshes[template], samples[template])
    for case, (mesh, sample) in enumerate(zip(meshes, samples, strict=True)):
        case_to_template = nearest_in_spectrum(
            C[template, case],
            samples[template].eigenvectors.cpu().numpy(),
            sample.eigenvectors.cpu().numpy(),
        )
        case_to_template = filtered_bijection(
            case_to_template,
            template_geodesics / stds[template],
            _geodesics(mesh, sample) / stds[case],
        )
        points[case, case_to_template] = mesh.vertices[sample.vertices]
        on_progress("match", case + 1, len(meshes))
    template_id = meshes[template].case_id
    shapes = CorrespondedShapes(
        points,
        joining_faces(meshes[template], samples[template].vertices),
        tuple(mesh.case_id for mesh in meshes),
        template_id,
    )
    return S3MResult(shapes, template_id, np.array(losses), template_losses)


@torch.no_grad()
def _all_maps(
    network: FeatureExtractor,
    samples: Sequence[Sample],
    settings: S3MSettings,
    generator: torch.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """(N, N, k, k) maps from the first to the second shape; (N,) each shape's mean loss."""
    features = [descriptors(network, [sample])[0] for sample in samples]
    coefficients = torch.stack(
        [sample.projection @ F for sample, F in zip(samples, features, strict=True)]
    )
    C = functional_maps(coefficients[:, None], coefficients[None, :])
    chosen = random_descriptors(settings, generator)
    operators = torch.cat(
        [
            multiplication_operators(
                F[None, :, chosen.to(F.device)], sample.projection[None], sample.eigenvectors[None]
            )
            for sample, F in zip(samples, features, strict=True)
        ]
    )
    values = stacked(samples, "eigenvalues")
    one_way = torch.stack(  # row by row: all pairs' preservation terms at once fill the memory
        [
            pair_losses(
                C[x : x + 1],
                C[:, x][None],
                values[x : x + 1],
                values,
                operators[x : x + 1],
                operators,
                settings,
            )[0]
            for x in range(len(samples))
        ]
    )
    return C.cpu().numpy(), (one_way + one_way.T).mean(dim=1).cpu().numpy()


def _kernel_stds(sizes: np.ndarray, settings: S3MSettings) -> np.ndarray:
    """(N,) mm, the filter's kernel on each case."""
    if settings.kernel_std_share is None:
        return np.full(len(sizes), np.sqrt(settings.kernel_variance_mm2))
    return settings.kernel_std_share * sizes


def _geodesics(mesh: Mesh, sample: Sample) -> np.ndarray:
    """(n, n) mm between the sampled vertices, along the surface."""
    between = geodesics_from(mesh.vertices, mesh.faces, sample.vertices)[:, sample.vertices]
    if not np.isfinite(between).all():
        raise CaseError(
            mesh.case_id,
            "the surface is in several pieces; S3M needs one. Keep the largest component.",
        )
    return between

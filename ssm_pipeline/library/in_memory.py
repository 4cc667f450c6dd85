"""Surfaces in memory → matcher, correspondences, corresponded shapes: the pipeline as functions.

The stages call the same functions and write what they return; these functions write nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ssm_pipeline.adaptation.correspond import (
    correspond_again,
    correspond_bases,
    pair_method,
)
from ssm_pipeline.adaptation.pose import CoarsePair
from ssm_pipeline.adaptation.rigid_start import rank_templates_by_distance
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.engine.process import chosen_device
from ssm_pipeline.meshing.decimation import decimate
from ssm_pipeline.methods import FULL
from ssm_pipeline.records import (
    CorrespondedShapes,
    Correspondence,
    Mesh,
    SpectralBasis,
    StudyError,
    refuse_doubled,
    require_each,
    require_type,
)
from ssm_pipeline.shape_model.cohort_matching import matched_cohort
from ssm_pipeline.shape_model.settings import GroupwiseSettings
from ssm_pipeline.spectral.basis import spectral_basis
from ssm_pipeline.spectral.settings import SpectralSettings
from ssm_pipeline.training.matcher import Matcher
from ssm_pipeline.training.settings import BUILT_IN_EIGENPAIRS, TrainingSettings
from ssm_pipeline.training.template_choice import choose_template
from ssm_pipeline.training.train import train_networks

MeshOrBasis = Mesh | SpectralBasis
MESH_OR_BASIS = (Mesh, SpectralBasis)
MATCHER_OR_NONE = (Matcher, type(None))
READ = "Read a file with read_mesh, or make a mesh from arrays with Mesh."
TRAIN = "Train one with train, or read one with load_matcher."
_SPECTRAL = SpectralSettings()


def train(
    surfaces: Sequence[MeshOrBasis],
    steps: int | None = None,
    settings: TrainingSettings | None = None,
    seed: int = 0,
    device: str | None = None,
    start: str | None = None,
) -> Matcher:
    """Train a matcher on the pairs of a cohort, without labels.

    Args:
        surfaces: Meshes in mm, which are coarsened first as a study's are (`settings.faces`); or
            spectral bases, which are used as they are. A matcher reads the coordinates of shapes
            that lie alike, to about 40 degrees. For shapes in any position pass
            `TrainingSettings(matching=MatchingSettings(features="wks"))`.
        steps: Optimiser steps, one pair each. None: as `settings` say.
        settings: Networks, losses and schedule. None: a study's defaults.
        seed: Decides the first weights and the order of the pairs.
        device: "cpu" or "cuda". None: cuda where there is one.
        start: "built-in": weights that were trained on synthetic shapes, which need few steps or
            none. The path of a matcher: its weights. None: as `settings` say, by default fresh
            weights.

    Returns:
        The trained matcher. `Matcher.save` writes it to a file.

    Raises:
        TypeError: For anything but meshes and bases.
        StudyError: For fewer than two surfaces, for bases with different numbers of eigenpairs, and
            for starting weights that do not fit.
        CaseError: For a surface that cannot be used.

    Source: Cao et al. 2024, "Spectral Meets Spatial", Eq. 14.

    Examples:
        >>> import trimesh
        >>> ball = trimesh.creation.icosphere(3)
        >>> meshes = [
        ...     Mesh(ball.vertices * size, ball.faces, f"case_{index}")
        ...     for index, size in enumerate([[30, 40, 50], [33, 39, 55], [28, 41, 47]])
        ... ]
        >>> matcher = train(meshes, steps=2, device="cpu")
        >>> matcher.trained_on
        ('case_0', 'case_1', 'case_2')
    """
    require_each(surfaces, MESH_OR_BASIS, "surfaces", READ)
    given = {"steps": steps, "start": start}
    changes = {name: value for name, value in given.items() if value is not None}
    settings = TrainingSettings.model_validate(
        (settings or TrainingSettings()).model_dump() | changes
    )
    spectral = _SPECTRAL
    if settings.start == "built-in":
        spectral = SpectralSettings(eigenpairs=BUILT_IN_EIGENPAIRS)
    bases = [_as_trained_on(surface, settings, spectral) for surface in surfaces]
    return train_networks(bases, settings, seed, chosen_device(device))


def correspond(
    template: MeshOrBasis,
    case: MeshOrBasis,
    matcher: Matcher | None,
    method: str = FULL,
    settings: AdaptationSettings | None = None,
    seed: int = 0,
) -> Correspondence:
    """Match a template to a case: for each of its vertices, a point on the case's surface.

    Args:
        template: A surface in mm. A mesh is also read at the density the matcher was trained at.
        case: A surface in mm.
        matcher: A matcher of `train`. None for the methods that use no network.
        method: "full", or an ablation: see `ssm_pipeline.methods`.
        settings: Of test-time adaptation. None: a study's defaults.
        seed: Decides the points that alignment and adaptation draw on both surfaces.

    Returns:
        The correspondence. `match.points_on(case)` are the points, `(V_template, 3)` mm.

    Raises:
        TypeError: For anything but meshes, bases and a matcher.
        StudyError: For a method that does not exist, and for a basis with more or fewer eigenpairs
            than the matcher was trained with.

    Source: Cao et al. 2024, "Spectral Meets Spatial", Eq. 15.

    Examples:
        >>> import trimesh
        >>> ball = trimesh.creation.icosphere(3)
        >>> template = Mesh(ball.vertices * [30, 40, 50], ball.faces, "template")
        >>> case = Mesh(ball.vertices * [33, 39, 55], ball.faces, "case")
        >>> match = correspond(template, case, matcher=None, method="adaptation only")
        >>> match.points_on(case).shape
        (642, 3)
    """
    require_type(template, MESH_OR_BASIS, "template", READ)
    require_type(case, MESH_OR_BASIS, "case", READ)
    require_type(matcher, MATCHER_OR_NONE, "matcher", TRAIN)
    spectral = _spectral_of(matcher)
    coarse: CoarsePair | None = None
    if matcher is not None and isinstance(template, Mesh) and isinstance(case, Mesh):
        coarse = (
            _as_trained_on(template, matcher.settings, spectral),
            _as_trained_on(case, matcher.settings, spectral),
        )
    return correspond_bases(
        _basis(template, spectral),
        _basis(case, spectral),
        matcher,
        settings or AdaptationSettings(),
        method,
        coarse,
        seed,
    )


def match_cohort(
    meshes: Sequence[Mesh],
    matcher: Matcher | None,
    template: str | None = None,
    rounds: int | None = None,
    method: str = FULL,
    settings: AdaptationSettings | None = None,
    seed: int = 0,
) -> CorrespondedShapes:
    """Put a cohort into correspondence: a template matched to all, then the mean shape, in rounds.

    Args:
        meshes: Closed surfaces in mm with a few thousand triangles each (`decimate`). They may lie
            anywhere, but must be oriented alike, to about 40 degrees.
        matcher: A matcher of `train`. None for the methods that use no network.
        template: The case that is matched to all others. None: the case with the smallest mean
            loss, or without a matcher the case nearest to the others.
        rounds: The number of groupwise rounds. In each, the mean of the shapes so far is adapted to
            every case again. None: as in a study. 0: the template only.
        method: "full", or an ablation: see `ssm_pipeline.methods`.
        settings: Of test-time adaptation. None: a study's defaults.
        seed: Decides the points that alignment and adaptation draw on the surfaces.

    Returns:
        Shapes `(N, V, 3)` mm, each in the case's own position, on the template's faces.

    Raises:
        TypeError: For anything but a list of meshes and a matcher.
        StudyError: For a template that is none of the cases, for two cases with one id, and for a
            method that does not exist.

    Examples:
        >>> import trimesh
        >>> ball = trimesh.creation.icosphere(3)
        >>> meshes = [
        ...     Mesh(ball.vertices * size, ball.faces, f"case_{index}")
        ...     for index, size in enumerate([[30, 40, 50], [33, 39, 55], [28, 41, 47]])
        ... ]
        >>> shapes = match_cohort(meshes, matcher=None, method="adaptation only", rounds=1)
        >>> shapes.vertices.shape, shapes.template_id
        ((3, 642, 3), 'case_0')
    """
    require_each(meshes, Mesh, "meshes", READ)
    require_type(matcher, MATCHER_OR_NONE, "matcher", TRAIN)
    pair_method(method)
    refuse_doubled([mesh.case_id for mesh in meshes])
    settings = settings or AdaptationSettings()
    groupwise = GroupwiseSettings() if rounds is None else GroupwiseSettings(rounds=rounds)
    by_id = {mesh.case_id: index for index, mesh in enumerate(meshes)}
    if template is not None and template not in by_id:
        raise StudyError(f"the template {template} is none of the cases: {', '.join(by_id)}.")
    spectral = _spectral_of(matcher)
    bases = [spectral_basis(mesh, spectral) for mesh in meshes]
    coarse = (
        [_as_trained_on(mesh, matcher.settings, spectral) for mesh in meshes] if matcher else None
    )
    if template is None:
        template = _most_like_the_others(matcher, coarse or bases, seed)
    chosen = by_id[template]

    def match(number: int, starts: Mapping[str, np.ndarray | None]) -> list[Correspondence]:
        return [match_case(by_id[case_id], start) for case_id, start in starts.items()]

    def match_case(case: int, start: np.ndarray | None) -> Correspondence:
        pair = bases[chosen], bases[case]
        if start is not None:
            return correspond_again(start, *pair, settings, seed)
        dense_as_trained = (coarse[chosen], coarse[case]) if coarse else None
        return correspond_bases(*pair, matcher, settings, method, dense_as_trained, seed)

    return matched_cohort(meshes[chosen], meshes, match, groupwise).shapes


def _most_like_the_others(
    matcher: Matcher | None, bases: Sequence[SpectralBasis], seed: int
) -> str:
    if matcher is not None:
        return choose_template(matcher, bases)[0]
    ranked = rank_templates_by_distance(bases, TrainingSettings().template_pairs, seed)
    return str(ranked.loc[ranked["mean_loss"].idxmin(), "case_id"])


def _spectral_of(matcher: Matcher | None) -> SpectralSettings:
    """As many eigenpairs as the matcher was trained with."""
    if matcher is None:
        return _SPECTRAL
    return SpectralSettings(eigenpairs=matcher.eigenpairs)


def _basis(surface: MeshOrBasis, spectral: SpectralSettings) -> SpectralBasis:
    return surface if isinstance(surface, SpectralBasis) else spectral_basis(surface, spectral)


def _as_trained_on(
    surface: MeshOrBasis, settings: TrainingSettings, spectral: SpectralSettings
) -> SpectralBasis:
    """The basis of a coarser mesh, as dense as those that are trained on."""
    if isinstance(surface, SpectralBasis):
        return surface
    return spectral_basis(decimate(surface, settings.faces), spectral)

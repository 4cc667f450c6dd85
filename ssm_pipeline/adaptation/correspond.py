"""Template and case → correspondence, by the full method or one of its ablations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from ssm_pipeline.adaptation.adapt import Adapted, adapt
from ssm_pipeline.adaptation.carried_onto import carried_onto
from ssm_pipeline.adaptation.distortion import distortion
from ssm_pipeline.adaptation.objective import MapPull, Triangles
from ssm_pipeline.adaptation.rigid_start import rigidly_aligned
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.geometry.rigid import best_similarity
from ssm_pipeline.matching.settings import InferenceMap
from ssm_pipeline.methods import FULL, Method, base_methods, method_named
from ssm_pipeline.records import Correspondence, SpectralBasis, StudyError

if TYPE_CHECKING:
    from ssm_pipeline.adaptation.pose import CoarsePair
    from ssm_pipeline.training.matcher import Matcher

Start = Literal["network", "turned", "rigid", "as scanned"]
NETWORK: Start = "network"
TURNED: Start = "turned"
RIGID: Start = "rigid"
AS_SCANNED: Start = "as scanned"
MEAN = "mean"  # of a groupwise round
Starts = dict[Start, tuple[np.ndarray, MapPull | None]]  # poses (V, 3), each with its pull if any
# Starts that are a map of the features instead of a pose. None: as the settings say.
MAP_OF: dict[str, InferenceMap | None] = {
    "feature map": None,
    "projected features": "projected",
    "features": "features",
}


def correspond_bases(
    template: SpectralBasis,
    case: SpectralBasis,
    matcher: Matcher | None,
    settings: AdaptationSettings,
    method: str = FULL,
    coarse: CoarsePair | None = None,
    seed: int = 0,
) -> Correspondence:
    """Match a template to a case.

    With every method the moved template is then projected onto the nearest point of the case's
    triangles. Both that point and the nearest vertex are kept. The methods are:

    - full: adapted to the case (Eq. 15–16) from the template rotated as the map says; from rigid
      alignment or the network's pose X(1) where that ends much less distorted (`settings.starts`)
    - network start: from the network's pose only, the paper's method
    - without adaptation: the map of the features, by `matching.inference_map`, the paper's row
    - spectral only: the same, of features trained on the spectral loss only
    - pose: the network's pose X(1)
    - projected features: nearest features, projected on the eigenbasis
    - features: nearest features
    - adaptation only: rigid alignment, adapted to the case; no network
    - as scanned: the template as it lies, centred, with the case's area, adapted; no network
    - nearest point: rigid alignment; no network

    Args:
        template: The template's basis.
        case: The case's basis.
        matcher: The trained networks. None for the methods that use none.
        settings: Of the adaptation.
        method: One of the methods above.
        coarse: See `pose_path`.
        seed: Decides the samples that alignment and adaptation draw.

    Returns:
        The correspondence.

    Raises:
        StudyError: For any other method.
    """
    how = pair_method(method)
    if not how.uses_network:
        if how.start == "as scanned":
            posed, start = template.vertices, AS_SCANNED
        else:
            posed, start = rigidly_aligned(template, case, seed), RIGID
        if how.adapts:
            posed = posed + _adapted(posed, template, case, settings, seed).offsets
        return _carried_onto(case, template, posed, start)
    if matcher is None:
        raise ValueError(f"the method {method!r} needs a trained matcher")
    # Here, so that what uses no network needs no PyTorch.
    from ssm_pipeline.adaptation.pose import carried_case, map_pull, pose_path

    goal = carried_case(template, case, matcher, MAP_OF.get(how.start))
    if how.start in MAP_OF:
        return _carried_onto(case, template, goal, NETWORK)
    pose = pose_path(template, case, matcher, np.ones(1), coarse, goal)[0]
    if not how.adapts:
        return _carried_onto(case, template, pose, NETWORK)
    starts: Starts = {NETWORK: (pose, map_pull(template, case, matcher, settings))}
    if how.start == "best" and settings.starts == "both":
        # Rigidly as the map says: it knows which way the template lies better than closest points
        # do, and a rigid start holds none of the map's noise.
        turn = best_similarity(template.vertices, goal, template.mass)
        starts = {
            TURNED: (turn.apply(template.vertices), None),
            RIGID: (rigidly_aligned(template, case, seed), None),
        } | starts
    return _carried_onto(case, template, *_kept_start(starts, template, case, settings, seed))


def pair_method(name: str) -> Method:
    """The method of `correspond` that has this name.

    Raises:
        StudyError: If there is none.
    """
    try:
        return method_named(name, base_methods("pair"))
    except ValueError as error:
        raise StudyError(str(error)) from error


def _kept_start(
    starts: Starts,
    template: SpectralBasis,
    case: SpectralBasis,
    settings: AdaptationSettings,
    seed: int,
) -> tuple[np.ndarray, Start]:
    """Adapted from each start, and the start that is kept: the first, or where one ends so much
    better (`settings.start_margin`) the best; by the surfaces' distance and the template's
    distortion, weighed as in adaptation."""
    ended: dict[Start, np.ndarray] = {}
    cost: dict[Start, float] = {}
    for start, (pose, pull) in starts.items():
        adapted = _adapted(pose, template, case, settings, seed, pull)
        ended[start] = pose + adapted.offsets
        if len(starts) == 1:
            return ended[start], start
        bent = distortion(template.vertices, ended[start], template.laplacian)
        cost[start] = adapted.chamfer() + settings.stiffness * bent
    first, best = next(iter(cost)), min(cost, key=lambda start: cost[start])
    kept = best if cost[best] < (1 - settings.start_margin) * cost[first] else first
    return ended[kept], kept


def correspond_again(
    start: np.ndarray,
    template: SpectralBasis,
    case: SpectralBasis,
    settings: AdaptationSettings,
    seed: int = 0,
) -> Correspondence:
    """Match by adaptation alone, from a shape on the template's faces already laid on the case.

    Args:
        start: (V, 3) mm, in the case's own space: a cohort's mean shape, say.
    """
    posed = case.frame.inverse().apply(start)
    offsets = _adapted(posed, template, case, settings, seed).offsets
    return _carried_onto(case, template, posed + offsets, MEAN)


def _adapted(
    posed: np.ndarray,
    template: SpectralBasis,
    case: SpectralBasis,
    settings: AdaptationSettings,
    seed: int,
    pull: MapPull | None = None,
) -> Adapted:
    moved, target = Triangles(posed, template.faces), Triangles(case.vertices, case.faces)
    return adapt(moved, template.laplacian, target, settings, seed, pull)


def _carried_onto(
    case: SpectralBasis, template: SpectralBasis, posed: np.ndarray, start: str
) -> Correspondence:
    return carried_onto(case, template.case_id, posed, case.frame.apply(posed), start)

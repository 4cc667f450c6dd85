"""Template and case → correspondence, by the full method or one of its ablations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from ssm_pipeline.adaptation.adapt import Adapted, adapt
from ssm_pipeline.adaptation.carried_onto import carried_onto
from ssm_pipeline.adaptation.distortion import distortion
from ssm_pipeline.adaptation.objective import MapPull
from ssm_pipeline.adaptation.rigid_start import rigidly_aligned
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.geometry.rigid import best_similarity
from ssm_pipeline.matching.settings import InferenceMap
from ssm_pipeline.methods import WITHOUT_NETWORK, PairMethod
from ssm_pipeline.records import Correspondence, SpectralBasis

if TYPE_CHECKING:
    from ssm_pipeline.adaptation.pose import CoarsePair
    from ssm_pipeline.training.matcher import Matcher

Start = Literal["network", "turned", "rigid", "as scanned"]
NETWORK: Start = "network"
TURNED: Start = "turned"
RIGID: Start = "rigid"
AS_SCANNED: Start = "as scanned"
MEAN = "mean"  # of a groupwise round
# Methods that are a map of the features and no more; None: as the settings say.
MAP_OF: dict[str, InferenceMap | None] = {
    "without adaptation": None,
    "spectral only": None,
    "projected features": "projected",
    "features": "features",
}


def correspond(
    template: SpectralBasis,
    case: SpectralBasis,
    matcher: Matcher | None,
    settings: AdaptationSettings,
    method: PairMethod = "full",
    coarse: CoarsePair | None = None,
    seed: int = 0,
) -> Correspondence:
    """Match a template to a case.

    full                adapted to the case (Eq. 15–16) from the network's pose X(1), from rigid
                        alignment and from the template turned as the map says; the least
                        distorted is kept (`settings.starts`)
    network start       from the network's pose alone: the paper's method
    without adaptation  the map of the features, by `matching.inference_map`: the paper's row
    spectral only       the same, of features trained on the spectral loss alone
    pose                the network's pose X(1)
    projected features  nearest features, projected on the eigenbasis
    features            nearest features
    adaptation only     rigid alignment, adapted to the case; no network
    as scanned          the template as it lies, centred, of the case's area, adapted; no network
    nearest point       rigid alignment; no network
    Whatever the method, the moved template is then carried to the nearest point on the case's
    triangles; both that point and the nearest vertex are kept.
    coarse  see `pose_path`. seed: of the samples that alignment and adaptation draw.
    """
    if method not in WITHOUT_NETWORK and matcher is None:
        raise ValueError(f"the method {method!r} needs a trained matcher")
    if method in MAP_OF:
        posed, start = _mapped(template, case, matcher, MAP_OF[method]), NETWORK
    elif method == "pose":
        posed, start = _network_pose(template, case, matcher, coarse), NETWORK
    elif method == "nearest point":
        posed, start = rigidly_aligned(template, case, seed), RIGID
    else:
        posed, start = _least_distorted(template, case, matcher, settings, method, coarse, seed)
    return _carried_onto(case, template, posed, start)


def _least_distorted(
    template: SpectralBasis,
    case: SpectralBasis,
    matcher: Matcher | None,
    settings: AdaptationSettings,
    method: PairMethod,
    coarse: CoarsePair | None,
    seed: int,
) -> tuple[np.ndarray, Start]:
    """Adapted from each start that the method has, and the start that ended best: where the
    surfaces' distance and the template's distortion, weighed as in adaptation, are least."""
    starts: dict[Start, tuple[np.ndarray, MapPull | None]] = {}
    if method == "as scanned":
        starts[AS_SCANNED] = template.vertices, None
    if method not in WITHOUT_NETWORK:
        pose = _network_pose(template, case, matcher, coarse)
        starts[NETWORK] = pose, _map_pull(template, case, matcher, settings)
    if method == "adaptation only" or (method == "full" and settings.starts == "both"):
        starts[RIGID] = rigidly_aligned(template, case, seed), None
        if method == "full":
            starts[TURNED] = _turned_by_the_map(template, case, matcher), None
    ended: dict[Start, np.ndarray] = {}
    cost: dict[Start, float] = {}
    for start, (pose, pull) in starts.items():
        adapted = _adapted(pose, template, case, settings, seed, pull)
        ended[start] = pose + adapted.offsets
        bent = distortion(template.vertices, ended[start], template.stiffness)
        cost[start] = adapted.chamfer + settings.stiffness * bent
    best = min(cost, key=lambda start: cost[start])
    return ended[best], best


def _turned_by_the_map(
    template: SpectralBasis, case: SpectralBasis, matcher: Matcher | None
) -> np.ndarray:
    """(V, 3) the template, moved rigidly as the features' map says: where closest points would turn
    it the wrong way, the map knows better, and a rigid start holds none of the map's noise."""
    goal = _mapped(template, case, matcher, None)
    return best_similarity(template.vertices, goal, template.mass).apply(template.vertices)


def _network_pose(
    template: SpectralBasis,
    case: SpectralBasis,
    matcher: Matcher | None,
    coarse: CoarsePair | None,
) -> np.ndarray:
    from ssm_pipeline.adaptation.pose import pose_path  # here: PyTorch is needed for it alone

    assert matcher is not None
    return pose_path(template, case, matcher, np.ones(1), coarse)[0]


def _mapped(
    template: SpectralBasis,
    case: SpectralBasis,
    matcher: Matcher | None,
    kind: InferenceMap | None,
) -> np.ndarray:
    from ssm_pipeline.adaptation.pose import carried_case

    assert matcher is not None
    return carried_case(template, case, matcher, kind)


def _map_pull(
    template: SpectralBasis,
    case: SpectralBasis,
    matcher: Matcher | None,
    settings: AdaptationSettings,
) -> MapPull | None:
    from ssm_pipeline.adaptation.pose import map_pull

    assert matcher is not None
    return map_pull(template, case, matcher, settings)


def correspond_again(
    start: np.ndarray,
    template: SpectralBasis,
    case: SpectralBasis,
    settings: AdaptationSettings,
    seed: int = 0,
) -> Correspondence:
    """Match by adaptation alone, from a shape on the template's faces already laid on the case.

    start  (V, 3) mm, in the case's own space: a cohort's mean shape, say.
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
    return adapt(
        posed, template.faces, template.stiffness, case.vertices, case.faces, settings, seed, pull
    )


def _carried_onto(
    case: SpectralBasis, template: SpectralBasis, posed: np.ndarray, start: str
) -> Correspondence:
    return carried_onto(case, template.case_id, posed, case.frame.apply(posed), start)

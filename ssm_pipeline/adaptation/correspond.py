"""Template and case → correspondence, by the full method or one of its ablations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ssm_pipeline.adaptation.adapt import adapt
from ssm_pipeline.adaptation.carried_onto import carried_onto
from ssm_pipeline.adaptation.objective import MapPull
from ssm_pipeline.adaptation.rigid_start import rigidly_aligned
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.matching.settings import InferenceMap
from ssm_pipeline.methods import WITHOUT_NETWORK, PairMethod
from ssm_pipeline.records import Correspondence, SpectralBasis

if TYPE_CHECKING:
    from ssm_pipeline.adaptation.pose import CoarsePair
    from ssm_pipeline.training.matcher import Matcher

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

    full                the network's pose X(1), adapted to the case (Eq. 15–16)
    without adaptation  the map of the features, by `matching.inference_map`: the paper's row
    spectral only       the same, of features trained on the spectral loss alone
    pose                the network's pose X(1)
    projected features  nearest features, projected on the eigenbasis
    features            nearest features
    adaptation only     rigid alignment, adapted to the case; no network
    nearest point       rigid alignment; no network
    Whatever the method, the moved template is then carried to the nearest point on the case's
    triangles; both that point and the nearest vertex are kept.
    coarse  see `pose_path`. seed: of the samples that alignment and adaptation draw.
    """
    if method in WITHOUT_NETWORK:
        posed, pull = rigidly_aligned(template, case, seed), None
    else:
        if matcher is None:
            raise ValueError(f"the method {method!r} needs a trained matcher")
        # Here, so that what uses no network needs no PyTorch.
        from ssm_pipeline.adaptation.pose import carried_case, map_pull, pose_path

        if method in MAP_OF:
            posed = carried_case(template, case, matcher, MAP_OF[method])
        else:
            posed = pose_path(template, case, matcher, np.ones(1), coarse)[0]
        pull = map_pull(template, case, matcher, settings) if method == "full" else None
    if method in ("full", "adaptation only"):
        posed = _adapted(posed, template, case, settings, seed, pull)
    return _carried_onto(case, template, posed)


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
    return _carried_onto(case, template, _adapted(posed, template, case, settings, seed))


def _adapted(
    posed: np.ndarray,
    template: SpectralBasis,
    case: SpectralBasis,
    settings: AdaptationSettings,
    seed: int,
    pull: MapPull | None = None,
) -> np.ndarray:
    return posed + adapt(
        posed, template.faces, template.stiffness, case.vertices, case.faces, settings, seed, pull
    )


def _carried_onto(
    case: SpectralBasis, template: SpectralBasis, posed: np.ndarray
) -> Correspondence:
    return carried_onto(case, template.case_id, posed, case.frame.apply(posed))

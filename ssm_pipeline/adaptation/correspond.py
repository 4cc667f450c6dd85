"""Template and case → correspondence, by the full method or one of its ablations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ssm_pipeline.adaptation.carried_onto import carried_onto
from ssm_pipeline.adaptation.rigid_start import rigidly_aligned
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.adaptation.starts import Start, adapt_to, kept_start, starts_from_map
from ssm_pipeline.matching.settings import InferenceMap
from ssm_pipeline.methods import FULL, Method, base_methods, method_named
from ssm_pipeline.records import Correspondence, SpectralBasis, StudyError

if TYPE_CHECKING:
    from ssm_pipeline.adaptation.pose import CoarsePair
    from ssm_pipeline.training.matcher import Matcher

MEAN = "mean"  # of a groupwise round
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

    - full: adapted to the case (Eq. 15–16) from the pose of the map: a rotation where shapes lie
      alike, as rigid as possible where the map bends the template; from rigid alignment where the
      map is doubtful and that ends much nearer and less distorted (`starts_from_map`)
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
            start = Start("as scanned", template.vertices)
        else:
            start = Start("rigid", rigidly_aligned(template, case, seed))
        if not how.adapts:
            return _carried_onto(case, template, start.pose, start)
        return _carried_onto(case, template, *kept_start([start], template, case, settings, seed))
    if matcher is None:
        raise ValueError(f"the method {method!r} needs a trained matcher")
    # Here, so that what uses no network needs no PyTorch.
    from ssm_pipeline.adaptation.pose import (
        carried_case,
        cycle_error,
        map_of_pose,
        map_pull,
        pose_path,
    )

    goal = carried_case(template, case, matcher, MAP_OF.get(how.start))
    if how.start in MAP_OF:
        return _carried_onto(case, template, goal, Start("network", goal))
    if how.start == "best" and settings.starts == "map":
        pair = template, case, matcher
        starts = starts_from_map(
            template,
            case,
            goal,
            lambda pose: map_of_pose(*pair, pose),
            lambda: cycle_error(*pair),
            settings,
            seed,
        )
        return _carried_onto(case, template, *kept_start(starts, template, case, settings, seed))
    pose = pose_path(template, case, matcher, np.ones(1), coarse, goal)[0]
    start = Start("network", pose, pull=map_pull(template, case, matcher, settings))
    if not how.adapts:
        return _carried_onto(case, template, pose, start)
    return _carried_onto(case, template, *kept_start([start], template, case, settings, seed))


def pair_method(name: str) -> Method:
    """The method of `correspond` that has this name.

    Raises:
        StudyError: If there is none.
    """
    try:
        return method_named(name, base_methods("pair"))
    except ValueError as error:
        raise StudyError(str(error)) from error


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
    offsets = adapt_to(case, template, posed, settings, seed).offsets
    return carried_onto(
        case, template.case_id, posed + offsets, case.frame.apply(posed + offsets), MEAN
    )


def _carried_onto(
    case: SpectralBasis, template: SpectralBasis, posed: np.ndarray, start: Start
) -> Correspondence:
    fitted = case.frame.apply(posed)
    return carried_onto(case, template.case_id, posed, fitted, start.name, start.why)

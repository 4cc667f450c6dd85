"""Template and case → correspondence, by the full method or one of its ablations."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ssm_pipeline.adaptation.adapt import adapt
from ssm_pipeline.adaptation.pose import CoarsePair, carried_case, pose_path
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.geometry.rigid import iterative_closest_point
from ssm_pipeline.geometry.surface import sample_points
from ssm_pipeline.methods import WITHOUT_NETWORK, PairMethod
from ssm_pipeline.records import Correspondence, SpectralBasis
from ssm_pipeline.training.matcher import Matcher


def correspond(
    template: SpectralBasis,
    case: SpectralBasis,
    matcher: Matcher | None,
    settings: AdaptationSettings,
    method: PairMethod = "full",
    coarse: CoarsePair | None = None,
) -> Correspondence:
    """Match a template to a case.

    full                the network's pose X(1), adapted to the case (Eq. 15–16)
    without adaptation  the network's pose X(1)
    spectral only       the soft map of the features alone
    adaptation only     rigid alignment, adapted to the case; no network
    nearest point       rigid alignment; no network
    Whatever the method, the moved template is then carried to the nearest point on the case's
    triangles; both that point and the nearest vertex are kept. `coarse`: see `pose_path`.
    """
    if method in WITHOUT_NETWORK:
        posed = _rigidly_aligned(template, case)
    else:
        if matcher is None:
            raise ValueError(f"the method {method!r} needs a trained matcher")
        if method == "spectral only":
            posed = carried_case(template, case, matcher)
        else:
            posed = pose_path(template, case, matcher, np.ones(1), coarse)[0]
    if method in ("full", "adaptation only"):
        posed = _adapted(posed, template, case, settings)
    return _carried_onto(case, template, posed)


def correspond_again(
    start: np.ndarray, template: SpectralBasis, case: SpectralBasis, settings: AdaptationSettings
) -> Correspondence:
    """Match by adaptation alone, from a shape on the template's faces already laid on the case.

    start  (V, 3) mm, in the case's own space: a cohort's mean shape, say.
    """
    posed = case.frame.inverse().apply(start)
    return _carried_onto(case, template, _adapted(posed, template, case, settings))


def _adapted(
    posed: np.ndarray, template: SpectralBasis, case: SpectralBasis, settings: AdaptationSettings
) -> np.ndarray:
    return posed + adapt(
        posed, template.faces, template.stiffness, case.vertices, case.faces, settings
    )


def _carried_onto(
    case: SpectralBasis, template: SpectralBasis, posed: np.ndarray
) -> Correspondence:
    on_case = closest_points(posed, case.vertices, case.faces)
    _, nearest_vertex = cKDTree(case.vertices).query(posed)
    return Correspondence(
        template_id=template.case_id,
        case_id=case.case_id,
        case_faces=on_case.faces,
        barycentric=on_case.barycentric,
        nearest_vertex=nearest_vertex.astype(np.int64),
        fitted=case.frame.apply(posed),
    )


def _rigidly_aligned(template: SpectralBasis, case: SpectralBasis) -> np.ndarray:
    """(V, 3): both at unit area and centred, then iterative closest points."""
    generator = np.random.default_rng(0)
    frame = iterative_closest_point(
        sample_points(template.vertices, template.faces, 4000, generator),
        sample_points(case.vertices, case.faces, 4000, generator),
    )
    return frame.apply(template.vertices)

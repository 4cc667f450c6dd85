"""The two-parameter path from a template to a case."""

from __future__ import annotations

import dataclasses

import numpy as np

from ssm_pipeline.adaptation.adapt import adapt
from ssm_pipeline.adaptation.pose import CoarsePair, pose_path
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records import ShapePath, SpectralBasis
from ssm_pipeline.training.matcher import Matcher


def shape_path(
    template: SpectralBasis,
    case: SpectralBasis,
    matcher: Matcher,
    settings: AdaptationSettings,
    coarse: CoarsePair | None = None,
    seed: int = 0,
) -> ShapePath:
    """X(t, t_s) = X(t) + t_s Δ_s(t), in millimetres on the template's faces.

    At each time the pose X(t) is adapted to Y(1 − t), the case's own path seen from its other end.
    Size and position go linearly from the template's to the case's. `coarse`: see `pose_path`.
    Source: Cao et al. 2024, Eq. 15–17; differs: as printed t_s = 0 already carries Δ_s, and the
    family would jump.
    """
    times = np.linspace(0, 1, settings.path_times)
    X = pose_path(template, case, matcher, times, coarse)
    Y = pose_path(case, template, matcher, 1 - times, (coarse[1], coarse[0]) if coarse else None)
    offsets = np.stack(
        [
            adapt(pose, template.faces, template.stiffness, goal, case.faces, settings, seed)
            for pose, goal in zip(X, Y, strict=True)
        ]
    )
    start, end = template.frame, case.frame
    scale = (1 - times) * start.scale + times * end.scale
    shift = (1 - times)[:, None] * start.translation + times[:, None] * end.translation
    frames = [Similarity(float(s), np.eye(3), move) for s, move in zip(scale, shift, strict=True)]
    return ShapePath(
        template_id=template.case_id,
        case_id=case.case_id,
        times=times,
        pose=np.stack([frame.apply(pose) for frame, pose in zip(frames, X, strict=True)]),
        offsets=np.stack(
            [
                dataclasses.replace(frame, translation=np.zeros(3)).apply(offset)
                for frame, offset in zip(frames, offsets, strict=True)
            ]
        ),
        faces=template.faces,
    )

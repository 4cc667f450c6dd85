"""The two-parameter path from a template to a case."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch

from ssm_pipeline.adaptation.adapt import adapt
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.records import Frame, ShapePath, SpectralBasis
from ssm_pipeline.training.matcher import Matcher


def shape_path(
    template: SpectralBasis, case: SpectralBasis, matcher: Matcher, settings: AdaptationSettings
) -> ShapePath:
    """X(t, t_s) = X(t) + t_s Δ_s(t), in millimetres on the template's faces.

    At each time the pose X(t) is adapted to Y(1 − t), the case's own path seen from its other end.
    Size and position go linearly from the template's to the case's. Source: Cao et al. 2024,
    Eq. 15–17; differs: as printed t_s = 0 already carries Δ_s, and the family would jump.
    """
    shape_x, shape_y = matcher.shape(template), matcher.shape(case)
    on_x, on_y = matcher.carried(shape_x, shape_y)
    times = torch.linspace(0, 1, settings.path_times)
    X = matcher.poses(shape_x, on_x, times).double().cpu().numpy()
    Y = matcher.poses(shape_y, on_y, 1 - times).double().cpu().numpy()
    offsets = np.stack(
        [
            adapt(pose, template.faces, template.stiffness, goal, case.faces, settings)
            for pose, goal in zip(X, Y, strict=True)
        ]
    )
    start, end = template.frame, case.frame
    t = times.double().numpy()
    scale = (1 - t) * start.scale + t * end.scale
    shift = (1 - t)[:, None] * start.translation + t[:, None] * end.translation
    frames = [Frame(float(s), np.eye(3), move) for s, move in zip(scale, shift, strict=True)]
    return ShapePath(
        template_id=template.case_id,
        case_id=case.case_id,
        times=t,
        pose=np.stack([frame.apply(pose) for frame, pose in zip(frames, X, strict=True)]),
        offsets=np.stack(
            [
                dataclasses.replace(frame, translation=np.zeros(3)).apply(offset)
                for frame, offset in zip(frames, offsets, strict=True)
            ]
        ),
        faces=template.faces,
    )

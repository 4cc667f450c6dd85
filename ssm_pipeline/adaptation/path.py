"""The two-parameter path from a template to a case."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from ssm_pipeline.adaptation.adapt import adapt
from ssm_pipeline.adaptation.objective import Triangles
from ssm_pipeline.adaptation.rigid_start import rigidly_aligned
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records import ShapePath, SpectralBasis

if TYPE_CHECKING:
    from ssm_pipeline.adaptation.pose import CoarsePair
    from ssm_pipeline.training.matcher import Matcher


def shape_path(
    template: SpectralBasis,
    case: SpectralBasis,
    matcher: Matcher | None,
    settings: AdaptationSettings,
    coarse: CoarsePair | None = None,
    seed: int = 0,
) -> ShapePath:
    """X(t, t_s) = X(t) + t_s Δ_s(t), in millimetres on the template's faces.

    At each time the pose X(t) is adapted to Y(1 − t), the case's own path seen from its other end.
    Size and position go linearly from the template's to the case's. Without a matcher the pose is
    the rigid alignment, and its one offset grows with t. `coarse`: see `pose_path`.
    Source: Cao et al. 2024, Eq. 15–17; differs: as printed t_s = 0 already carries Δ_s, and the
    family would jump.
    """
    times = np.linspace(0, 1, settings.path_times)

    def adapted(pose: np.ndarray, goal: np.ndarray) -> np.ndarray:
        moved, target = Triangles(pose, template.faces), Triangles(goal, case.faces)
        return adapt(moved, template.laplacian, target, settings, seed).offsets

    if matcher is None:
        pose = rigidly_aligned(template, case, seed)
        X = np.broadcast_to(pose, (len(times), *pose.shape))
        offsets = times[:, None, None] * adapted(pose, case.vertices)
    else:
        from ssm_pipeline.adaptation.pose import pose_path  # PyTorch is needed for it alone

        X = pose_path(template, case, matcher, times, coarse)
        swapped = (coarse[1], coarse[0]) if coarse else None
        Y = pose_path(case, template, matcher, 1 - times, swapped)
        offsets = np.stack([adapted(pose, goal) for pose, goal in zip(X, Y, strict=True)])
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

"""Where adaptation starts, and which start is kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ssm_pipeline.adaptation.adapt import Adapted, adapt
from ssm_pipeline.adaptation.distortion import distortion
from ssm_pipeline.adaptation.map_start import map_start
from ssm_pipeline.adaptation.objective import MapPull, Triangles
from ssm_pipeline.adaptation.rigid_start import rigid_motion
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.geometry.rigid import best_similarity
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records import SpectralBasis

StartName = Literal["map", "turned", "rigid", "network", "as scanned"]
# Two rigid poses that differ by less lead to the same result.
SAME_POSE_DEG = 15.0


@dataclass(frozen=True, eq=False)
class Start:
    """One pose from which a template is adapted.

    Attributes:
        name: As `Correspondence.start` has it.
        pose: (V, 3) the template's vertices in the case's space, unit area.
        why: The reason for this start, in a few words; empty where the method names the start.
        pull: Where a map pulls the vertices during adaptation, if it does.
    """

    name: StartName
    pose: np.ndarray
    why: str = ""
    pull: MapPull | None = None


def starts_from_map(
    template: SpectralBasis,
    case: SpectralBasis,
    targets: np.ndarray,
    map_of_pose: Callable[[np.ndarray], np.ndarray],
    cycle_error: Callable[[], float],
    settings: AdaptationSettings,
    seed: int,
) -> list[Start]:
    """One start, or two where the map may be wrong; the one that follows the map comes first.

    A map that bends the template by more than `settings.rigid_below` gives its pose, made as rigid
    as possible (`map_start`). Otherwise the shapes lie alike up to a rotation and the map gives
    only that rotation: the rigid pose holds none of the map's noise. The rigid alignment by closest
    points is a second start where it contradicts the map and the map may be wrong. A map that bends
    the template and whose cycle error is at most `settings.trusted_cycle` is right: the rigid start
    is refused.

    Args:
        targets: (V, 3) where the map sends each vertex of the template.
        map_of_pose: The map that a pose (V, 3) of the template describes, as such targets: its
            nearest vertices of the case, projected on the eigenbasis. The pose of a map is a better
            map than the one that it came from, so a bending map is refined in this way, once per
            further weight in `settings.start_map_weights`. Source: Melzi et al. 2019 (ZoomOut) for
            the projection.
        cycle_error: The mean distance of template → case → template from its beginning, √area;
            computed only where it is needed.
    """

    def pose_of(targets: np.ndarray, weight: float) -> np.ndarray:
        return map_start(template.vertices, targets, template.laplacian, template.mass, weight)

    x = pose_of(targets, settings.start_map_weights[0])
    unbent = best_similarity(template.vertices, x, template.mass).apply(template.vertices)
    bending = float(template.mass @ np.linalg.norm(x - unbent, axis=1))
    said = f"the map bends the template by {bending:.3f} √area"
    if bending > settings.rigid_below:
        for weight in settings.start_map_weights[1:]:
            x = pose_of(map_of_pose(x), weight)
        error = cycle_error()
        said += f", cycle error {error:.3f}"
        if error <= settings.trusted_cycle:
            return [Start("map", x, said)]
        return [Start("map", x, said), _closest_points(template, case, seed)[1]]
    turn = best_similarity(template.vertices, targets, template.mass)
    first = Start("turned", turn.apply(template.vertices), said)
    motion, second = _closest_points(template, case, seed)
    return [first] if _degrees_between(turn, motion) <= SAME_POSE_DEG else [first, second]


def kept_start(
    starts: Sequence[Start],
    template: SpectralBasis,
    case: SpectralBasis,
    settings: AdaptationSettings,
    seed: int,
) -> tuple[np.ndarray, Start]:
    """The adapted template (V, 3) from the start that is kept.

    That is the first, unless another ends with less by `settings.start_margin`: the distance of the
    surfaces plus the distortion of the template, weighted as in adaptation.
    """
    ended, costs = [], []
    for start in starts:
        adapted = adapt_to(case, template, start.pose, settings, seed, start.pull)
        ended.append(start.pose + adapted.offsets)
        if len(starts) == 1:
            return ended[0], start
        bent = distortion(template.vertices, ended[-1], template.laplacian)
        costs.append(adapted.chamfer() + settings.stiffness * bent)
    best = int(np.argmin(costs))
    kept = best if costs[best] < (1 - settings.start_margin) * costs[0] else 0
    compared = "; ".join(
        f"{start.name} ends at {1e4 * cost:.2f}e-4"
        for start, cost in zip(starts, costs, strict=True)
    )
    first, found = starts[0], starts[kept]
    return ended[kept], Start(found.name, found.pose, f"{first.why}; {compared}", found.pull)


def adapt_to(
    case: SpectralBasis,
    template: SpectralBasis,
    pose: np.ndarray,
    settings: AdaptationSettings,
    seed: int,
    pull: MapPull | None = None,
) -> Adapted:
    """Adapt the template from a pose (V, 3) to the case."""
    moved, target = Triangles(pose, template.faces), Triangles(case.vertices, case.faces)
    return adapt(moved, template.laplacian, target, settings, seed, pull)


def _closest_points(
    template: SpectralBasis, case: SpectralBasis, seed: int
) -> tuple[Similarity, Start]:
    motion = rigid_motion(template, case, seed)
    return motion, Start("rigid", motion.apply(template.vertices), "closest points")


def _degrees_between(one: Similarity, other: Similarity) -> float:
    cosine = (np.trace(one.rotation.T @ other.rotation) - 1) / 2
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))

"""The network's pose path X(t) of a template on its way to a case."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree

from ssm_pipeline.adaptation.objective import MapPull
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.geometry.barycentric import interpolated
from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.matching.hard_map import nearest_features, projected
from ssm_pipeline.matching.settings import InferenceMap
from ssm_pipeline.records import SpectralBasis
from ssm_pipeline.training.matcher import Matcher

CoarsePair = tuple[SpectralBasis, SpectralBasis]  # template and case, as dense as trained on


def pose_path(
    template: SpectralBasis,
    case: SpectralBasis,
    matcher: Matcher,
    times: np.ndarray,
    coarse: CoarsePair | None = None,
    target: np.ndarray | None = None,
) -> np.ndarray:
    """(T, V, 3) unit area: X(t) = X + t Ω on the template's vertices, at each of `times` (T,).

    The map is found on the meshes as they are; the interpolator is given Y[map].

    Args:
        coarse: The same two surfaces as densely triangulated as the meshes that were trained on.
            The interpolator sees one-rings, so it is at home there; its displacements are then
            carried to the template's own vertices.
        target: `carried_case` of the two, where it is known already.
    """
    target = carried_case(template, case, matcher) if target is None else target
    if coarse is None:
        return _posed(template, target, matcher, times)
    network_template, fine_in_coarse = coarse[0], coarse[0].frame.inverse()
    fine = fine_in_coarse.apply(template.frame.apply(template.vertices))
    goal = coarse[1].frame.inverse().apply(case.frame.apply(target))
    _, nearest = cKDTree(fine).query(network_template.vertices)
    X = _posed(network_template, goal[nearest], matcher, times)
    place = closest_points(fine, network_template.vertices, network_template.faces)
    corners = network_template.faces[place.faces]
    moved = interpolated(X - network_template.vertices, corners, place.barycentric)
    result: np.ndarray = template.vertices + moved
    return result


def carried_case(
    template: SpectralBasis,
    case: SpectralBasis,
    matcher: Matcher,
    kind: InferenceMap | None = None,
) -> np.ndarray:
    """(V, 3) unit area: Π_xy Y, the case's coordinates by the features' map (`Matcher.carried`)."""
    target = matcher.carried(matcher.shape(template), matcher.shape(case), kind)
    return target.double().cpu().numpy()


def cycle_error(template: SpectralBasis, case: SpectralBasis, matcher: Matcher) -> float:
    """The mean distance that template → case → template moves a point, √area.

    Always of the projected features, which is what `full` follows.
    """
    return float(template.mass @ _cycle(template, case, matcher, True)[1])


def map_of_pose(
    template: SpectralBasis, case: SpectralBasis, matcher: Matcher, pose: np.ndarray
) -> np.ndarray:
    """(V, 3) the case's vertices nearest to a pose of the template, that map projected."""
    _, nearest = cKDTree(case.vertices).query(pose)
    shape_x, shape_y = matcher.shape(template), matcher.shape(case)
    x_to_y = projected(torch.as_tensor(nearest, device=matcher.device), shape_x, shape_y)
    return np.asarray(case.vertices[x_to_y.cpu().numpy()])


def map_pull(
    template: SpectralBasis, case: SpectralBasis, matcher: Matcher, settings: AdaptationSettings
) -> MapPull | None:
    """Where the hard map says each vertex of the template goes, and how sure it is of it.

    Sure where the cycle template → case → template ends near its start. None for a weight of 0.
    """
    if settings.map_weight == 0:
        return None
    projects = matcher.settings.matching.inference_map != "features"
    x_to_y, cycle = _cycle(template, case, matcher, projects)
    confidence = np.exp(-0.5 * (cycle / settings.cycle_scale) ** 2)
    return MapPull(case.vertices[x_to_y], settings.map_weight * template.mass * confidence)


def _cycle(
    template: SpectralBasis, case: SpectralBasis, matcher: Matcher, projects: bool
) -> tuple[np.ndarray, np.ndarray]:
    """(V,) the case's vertex for each of the template's, and how far off the way back ends."""
    shape_x, shape_y = matcher.shape(template), matcher.shape(case)
    features_x, features_y = matcher.features(shape_x), matcher.features(shape_y)
    there = nearest_features(features_x, features_y)
    back = nearest_features(features_y, features_x)
    if projects:
        there = projected(there, shape_x, shape_y)
        back = projected(back, shape_y, shape_x)
    x_to_y, y_to_x = there.cpu().numpy(), back.cpu().numpy()
    return x_to_y, np.linalg.norm(template.vertices[y_to_x[x_to_y]] - template.vertices, axis=1)


def _posed(
    template: SpectralBasis, target: np.ndarray, matcher: Matcher, times: np.ndarray
) -> np.ndarray:
    shape = matcher.shape(template)
    goal = torch.as_tensor(target, dtype=shape.vertices.dtype, device=shape.vertices.device)
    return matcher.poses(shape, goal, torch.as_tensor(times)).double().cpu().numpy()

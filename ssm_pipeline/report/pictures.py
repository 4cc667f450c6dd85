"""What the still pictures of the page and of the figures show: the scenes, not their layout."""

from __future__ import annotations

import numpy as np

from ssm_pipeline.geometry.surface import vertex_normals
from ssm_pipeline.records import ShapePath
from ssm_pipeline.report.rendering import Scene
from ssm_pipeline.report.rounding import FINE, round_up
from ssm_pipeline.shape_model.model import ShapeModel


def signed_distance(vertices: np.ndarray, model: ShapeModel) -> np.ndarray:
    """(V,) mm: displacement from the mean along the mean's outward normal."""
    normals = vertex_normals(model.mean, model.faces)
    result: np.ndarray = np.einsum("vd,vd->v", vertices - model.mean, normals)
    return result


def mode_range_mm(model: ShapeModel, count: int, deviations: float) -> float:
    """A round colour range in mm that 99 % of the vertices of the first modes stay within."""
    normals = vertex_normals(model.mean, model.faces)
    along = np.einsum("mvd,vd->mv", model.modes[:count], normals)
    largest = np.percentile(np.abs(along), 99, axis=1) * model.standard_deviations[:count]
    return round_up(max(float(largest.max()) * deviations, 1e-3), FINE)


def mode_scenes(model: ShapeModel, count: int, deviations: float) -> list[Scene]:
    """The mean, then for each mode −k SD and +k SD, painted by signed distance from the mean."""
    scores = np.zeros((1 + 2 * count, count))
    for mode in range(count):
        scores[1 + 2 * mode, mode], scores[2 + 2 * mode, mode] = -deviations, deviations
    shapes = model.reconstruct(scores)
    return [
        Scene(shapes[0], model.faces),
        *(Scene(shape, model.faces, signed_distance(shape, model)) for shape in shapes[1:]),
    ]


def interpolation_scenes(
    path: ShapePath, times: np.ndarray, shape_times: np.ndarray
) -> list[Scene]:
    """The path's shapes X(t, t_s) at pairs of pose time and shape time."""
    return [
        Scene(path.at(float(t), float(t_s)), path.faces)
        for t, t_s in zip(times, shape_times, strict=True)
    ]

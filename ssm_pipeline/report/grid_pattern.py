"""A grid painted on the template: where it lands on a case shows the correspondence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssm_pipeline.geometry.surface import vertex_normals
from ssm_pipeline.report.rendering import Scene
from ssm_pipeline.report.rounding import round_up

_LINE = np.array([40, 44, 52])


def grid_spacing_mm(template: np.ndarray) -> float:
    """A round distance between grid planes: about twelve along the template's longest side."""
    return round_up(float(np.ptp(template, axis=0).max()) / 15)


def pattern_colours(
    positions: np.ndarray, normals: np.ndarray, template: np.ndarray, spacing_mm: float
) -> np.ndarray:
    """(P, 3) uint8 colours at `positions` (P, 3) on the template, where it has `normals` (P, 3).

    The hue says where on the template (x red, y green, z blue); dark lines are its planes of
    constant left-right, front-back and head-foot position, every `spacing_mm`.
    """
    low, high = template.min(axis=0), template.max(axis=0)
    colours = 95 + 150 * (positions - low) / (high - low)
    to_plane = np.abs((positions / spacing_mm + 0.5) % 1 - 0.5)
    # Along the surface, not across it: or a plane that only touches it would paint a blot.
    along = to_plane / np.sqrt(np.maximum(1 - normals**2, 1e-6))
    colours = np.where(along.min(axis=1)[:, None] < 0.05, _LINE, colours)
    return np.clip(colours, 0, 255).astype(np.uint8)


def patterned_scenes(
    shapes: Sequence[np.ndarray], faces: np.ndarray, template: np.ndarray, steps: int = 4
) -> list[Scene]:
    """Corresponded shapes, (V, 3) each, with the template's grid on them.

    Triangles are cut into `steps`² for sharp lines.
    """
    weights, pattern = _subdivided_triangle(steps)
    on_template = np.einsum("kc,fcd->fkd", weights, template[faces]).reshape(-1, 3)
    # Neighbouring triangles repeat their common points; welding them makes the shading smooth.
    _, first, inverse = np.unique(
        np.round(on_template, 5), axis=0, return_index=True, return_inverse=True
    )
    corners = inverse.reshape(len(faces), -1)[:, pattern].reshape(-1, 3)
    normals = np.einsum("kc,fcd->fkd", weights, vertex_normals(template, faces)[faces])
    colours = pattern_colours(
        on_template[first], normals.reshape(-1, 3)[first], template, grid_spacing_mm(template)
    )
    return [
        Scene(
            np.einsum("kc,fcd->fkd", weights, shape[faces]).reshape(-1, 3)[first],
            corners,
            colours=colours,
        )
        for shape in shapes
    ]


def _subdivided_triangle(steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric weights (K, 3) of a triangle's regular subdivision, and its triangles (S, 3)."""
    number: dict[tuple[int, int], int] = {}
    for i in range(steps + 1):
        for j in range(steps + 1 - i):
            number[i, j] = len(number)
    weights = np.array([[steps - i - j, i, j] for i, j in number], dtype=np.float64) / steps
    triangles = [
        (number[i, j], number[i + 1, j], number[i, j + 1]) for i, j in number if i + j < steps
    ]
    triangles += [
        (number[i + 1, j], number[i + 1, j + 1], number[i, j + 1])
        for i, j in number
        if i + j < steps - 1
    ]
    return weights, np.array(triangles)

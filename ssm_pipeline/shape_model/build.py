"""Corresponded shapes → the shape model, in one call."""

from __future__ import annotations

from ssm_pipeline.records import CorrespondedShapes, require_type
from ssm_pipeline.shape_model.alignment import align
from ssm_pipeline.shape_model.model import ShapeModel
from ssm_pipeline.shape_model.pca import pca_model


def build_model(shapes: CorrespondedShapes, with_scale: bool = False) -> ShapeModel:
    """Align shapes that correspond, and find their mean and modes of variation.

    Args:
        shapes: N >= 3 cases, `(N, V, 3)` mm, each in its own position: of `match_cohort`, or of any
            other method whose vertex v is the same point in all cases.
        with_scale: Whether alignment also removes size. By default size is a mode.

    Returns:
        The model with all modes, at most N − 1, in mm, and with the cases' scores.

    Raises:
        TypeError: For anything but `CorrespondedShapes`.
        StudyError: For fewer than three shapes.

    Source: Cootes et al. 1995, "Active shape models: their training and application".

    Examples:
        >>> import numpy as np
        >>> corners = np.array([[0.0, 0, 0], [30, 0, 0], [0, 40, 0], [0, 0, 50]])
        >>> faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
        >>> vertices = np.stack([corners * size + 100 * size for size in (0.9, 1.0, 1.2)])
        >>> shapes = CorrespondedShapes(vertices, faces, ("a", "b", "c"), template_id="b")
        >>> model = build_model(shapes)
        >>> model.modes_for(0.999)  # they differ only in size and place
        1
    """
    require_type(shapes, CorrespondedShapes, "shapes", "match_cohort returns them.")
    return pca_model(align(shapes, with_scale=with_scale)[0])

"""Principal component analysis of aligned shapes."""

from __future__ import annotations

import numpy as np

from ssm_pipeline.records import CorrespondedShapes, StudyError
from ssm_pipeline.shape_model.model import ShapeModel


def pca_model(shapes: CorrespondedShapes) -> ShapeModel:
    """The point distribution model of aligned shapes: all modes kept, at most N − 1.

    By the singular values of the centred N × 3V data, so nothing of size 3V × 3V is ever formed.
    Each mode's sign is fixed (its largest displacement points towards +), so that a rerun shows
    the same pictures. Raises StudyError for fewer than three shapes, or where all are equal.
    """
    count, vertex_count, _ = shapes.vertices.shape
    if count < 3:
        raise StudyError(
            f"a shape model needs at least 3 usable cases; {count} found. Add cases, or look at "
            "the reasons why others were dropped."
        )
    data = shapes.vertices.reshape(count, -1)
    mean = data.mean(axis=0)
    _, singular, Vt = np.linalg.svd(data - mean, full_matrices=False)
    if singular[0] <= 1e-12 * np.linalg.norm(data):
        raise StudyError(
            f"all {count} shapes are equal: there is nothing in which they vary. Look whether one "
            "file was given for all cases."
        )
    kept = singular > singular[0] * 1e-8  # the N-th singular value is round-off, always
    kept[count - 1 :] = False
    modes, singular = Vt[kept], singular[kept]
    largest = np.abs(modes).argmax(axis=1)
    modes *= np.sign(modes[np.arange(len(modes)), largest])[:, None]
    variances = singular**2 / (count - 1)
    return ShapeModel(
        mean=mean.reshape(vertex_count, 3),
        modes=modes.reshape(-1, vertex_count, 3),
        variances=variances,
        faces=shapes.faces,
        scores=(data - mean) @ modes.T / np.sqrt(variances),
        case_ids=shapes.case_ids,
    )

"""Principal component analysis of aligned shapes."""

from __future__ import annotations

import numpy as np

from ssm_pipeline.records import CorrespondedShapes, StudyError
from ssm_pipeline.shape_model.model import ShapeModel

BLOCK = 1000  # cases; up to so many, the whole data fit, and singular values are more exact


def pca_model(shapes: CorrespondedShapes) -> ShapeModel:
    """The point distribution model of aligned shapes: all modes kept, at most N − 1.

    By the smaller side of the centred N × 3V data: its singular values, or, of thousands of cases
    and fewer coordinates, the eigenvalues of their covariance, added up a block of cases at a time.
    Each mode's sign is fixed (its largest displacement points towards +), so that a rerun shows the
    same pictures.

    Raises:
        StudyError: For fewer than three shapes, or where all are equal.
    """
    count, vertex_count, _ = shapes.vertices.shape
    if count < 3:
        raise StudyError(
            f"a shape model needs at least 3 usable cases; {count} found. Add cases, or look at "
            "the reasons why others were dropped."
        )
    data = shapes.vertices.reshape(count, -1)
    mean = data.mean(axis=0)
    many = count > max(data.shape[1], BLOCK)
    singular, Vt = _by_coordinates(data, mean) if many else _by_cases(data, mean)
    if singular[0] <= 1e-12 * np.linalg.norm(data):
        raise StudyError(
            f"all {count} shapes are equal: there is nothing in which they vary. Look whether one "
            "file was given for all cases."
        )
    # The N-th singular value is round-off, always; of a covariance, what is below its root.
    kept = singular > singular[0] * (1e-7 if many else 1e-8)
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


def _by_cases(data: np.ndarray, mean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    _, singular, Vt = np.linalg.svd(data - mean, full_matrices=False)
    return singular, Vt


def _by_coordinates(data: np.ndarray, mean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    squares = np.zeros((data.shape[1], data.shape[1]))
    for begin in range(0, len(data), BLOCK):
        block = data[begin : begin + BLOCK] - mean
        squares += block.T @ block
    eigenvalues, axes = np.linalg.eigh(squares)
    return np.sqrt(np.maximum(eigenvalues[::-1], 0)), axes.T[::-1].copy()

"""How much of what differs between corresponding shapes an affine map describes."""

from __future__ import annotations

import numpy as np

from ssm_pipeline.geometry.rigid import best_similarity


def affine_share(shapes: np.ndarray, steps: int = 20) -> float:
    """Share (0 … 1) of the variance about the mean that affine maps of the mean explain.

    Args:
        shapes: (N, V, 3), vertex v the same point in all; any unit. Pose is removed first, as a
            shape model does (each turned onto the common mean), so that turns and shifts count for
            nothing. The mean is mapped onto each shape by the affine map of least squares.

    Raises:
        ValueError: For shapes that do not differ.

    >>> points = np.random.default_rng(0).standard_normal((100, 3))
    >>> round(affine_share(np.stack([points, points * [1, 1, 1.2], points * [1.1, 1, 1]])), 3)
    1.0
    """
    mean = shapes[0] - shapes[0].mean(axis=0)
    for _ in range(steps):
        aligned = np.stack([best_similarity(shape, mean).apply(shape) for shape in shapes])
        mean = aligned.mean(axis=0)
    total = ((aligned - mean) ** 2).sum()
    if total <= 1e-12 * (mean**2).sum():
        raise ValueError("the shapes do not differ, so that no share of their variance is affine")
    known = np.column_stack([mean, np.ones(len(mean))])
    moved = (aligned - mean).transpose(1, 0, 2).reshape(len(mean), -1)
    rest = moved - known @ np.linalg.lstsq(known, moved, rcond=None)[0]
    return float(1 - (rest**2).sum() / total)

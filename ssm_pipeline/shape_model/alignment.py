"""Generalised Procrustes alignment of corresponded shapes."""

from __future__ import annotations

import dataclasses

import numpy as np

from ssm_pipeline.geometry.rigid import best_similarity
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records import CorrespondedShapes


def align(
    shapes: CorrespondedShapes, with_scale: bool = False, tolerance: float = 1e-10
) -> tuple[CorrespondedShapes, tuple[Similarity, ...]]:
    """Remove the pose of each shape (and its size, if requested) by aligning all with their mean.

    The mean keeps the template's orientation, so "up" stays up, and is centred at the origin.
    Without size, all are as large as they are on average, whichever of them is the template.

    Returns:
        The aligned shapes and, per case, the frame from its own millimetres to the model's.

    Source: Gower 1975; Dryden and Mardia 1998, ch. 4.
    """
    points = shapes.vertices
    reference = shapes.template - shapes.template.mean(axis=0)
    mean = reference
    size = np.linalg.norm(points - points.mean(axis=1, keepdims=True), axis=(1, 2)).mean()
    for _ in range(100):
        frames = [best_similarity(shape, mean, with_scale=with_scale) for shape in points]
        aligned = np.stack([f.apply(shape) for f, shape in zip(frames, points, strict=True)])
        new = aligned.mean(axis=0)
        if with_scale:  # or all shapes would shrink to a point together
            new *= size / np.linalg.norm(new)
        new = best_similarity(new, reference).apply(new)
        change = np.linalg.norm(new - mean) / size
        mean = new
        if change < tolerance:
            break
    return dataclasses.replace(shapes, vertices=aligned), tuple(frames)

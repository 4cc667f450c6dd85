"""Groupwise rounds: the cohort's mean shape is aligned with every case and matched again."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Literal

import numpy as np

from ssm_pipeline.geometry.rigid import best_similarity
from ssm_pipeline.records import CorrespondedShapes, Correspondence, Mesh
from ssm_pipeline.shape_model.alignment import align
from ssm_pipeline.shape_model.settings import GroupwiseSettings

MatchStarts = Callable[[int, Mapping[str, np.ndarray]], Sequence[Correspondence]]


def groupwise_rounds(
    shapes: CorrespondedShapes,
    meshes: Sequence[Mesh],
    settings: GroupwiseSettings,
    match: MatchStarts,
    mean_of: Collection[str] | None = None,
) -> CorrespondedShapes:
    """The shapes after `settings.rounds` rounds of matching the mean, in the template's place.

    Args:
        shapes: Each in its own millimetres.
        meshes: Of the cases that `match` matches, in its order.
        match: (round from 1, case → (V, 3) mm start) → correspondences, of all cases or of some:
            the others stay as they are.
        mean_of: The cases that the means are made of; None: all.
    """
    for number in range(1, settings.rounds + 1):
        shapes, _ = groupwise_round(number, shapes, meshes, settings, match, mean_of)
    return shapes


def groupwise_round(
    number: int,
    shapes: CorrespondedShapes,
    meshes: Sequence[Mesh],
    settings: GroupwiseSettings,
    match: MatchStarts,
    mean_of: Collection[str] | None = None,
) -> tuple[CorrespondedShapes, Sequence[Correspondence]]:
    """One of the `groupwise_rounds`: the shapes after it, and the matches that it made."""
    matches = match(number, placed_means(shapes, mean_of, settings.laid_on))
    vertices = np.array(shapes.vertices)
    for found, mesh in zip(matches, meshes, strict=True):
        vertices[shapes.case_ids.index(found.case_id)] = found.points_on(mesh)
    return dataclasses.replace(shapes, vertices=vertices), matches


def placed_means(
    shapes: CorrespondedShapes,
    mean_of: Collection[str] | None = None,
    laid_on: Literal["similarity", "affine"] = "similarity",
) -> dict[str, np.ndarray]:
    """Case → (V, 3) mm: the Procrustes mean, aligned with the case by the best map of its points.

    The mean of a cohort is nearer to each case than any single template is, and what one matching
    got wrong along the surface averages out of it: a template adapted from here slides less.
    Found with every point's match in hand, the map needs no search.

    Args:
        shapes: As matched, each in its own millimetres.
        mean_of: The cases that the mean is made of; None: all. It is aligned with the others too.

    Source: the unbiased atlas of Joshi et al. 2004, on surfaces.
    """
    kept = [i for i, case in enumerate(shapes.case_ids) if mean_of is None or case in mean_of]
    mean = align(shapes.subset(kept))[0].vertices.mean(axis=0)
    laid = _affinely if laid_on == "affine" else _similarly
    return {
        case_id: laid(mean, points)
        for case_id, points in zip(shapes.case_ids, shapes.vertices, strict=True)
    }


def _similarly(mean: np.ndarray, points: np.ndarray) -> np.ndarray:
    return best_similarity(mean, points, with_scale=True).apply(mean)


def _affinely(mean: np.ndarray, points: np.ndarray) -> np.ndarray:
    with_one = np.column_stack([mean, np.ones(len(mean))])
    result: np.ndarray = with_one @ np.linalg.lstsq(with_one, points, rcond=None)[0]
    return result

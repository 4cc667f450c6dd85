"""A cohort in correspondence: the template matched to each case, then the groupwise rounds.

The same function serves arrays in memory and the files of a run: the caller passes in what
matches the cases.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ssm_pipeline.records import CorrespondedShapes, Correspondence, Mesh
from ssm_pipeline.shape_model.collected_points import collect
from ssm_pipeline.shape_model.groupwise_rounds import groupwise_round
from ssm_pipeline.shape_model.settings import GroupwiseSettings

MatchCases = Callable[[int, Mapping[str, np.ndarray | None]], Sequence[Correspondence]]


@dataclass(frozen=True, eq=False)
class MatchedCohort:
    """The cases of a cohort by one method.

    Attributes:
        shapes: On the surface of each case, in its own millimetres.
        fitted: `(N, V, 3)` mm, the same points before they were projected onto the surfaces. None
            for a method whose points are vertices of the cases.
    """

    shapes: CorrespondedShapes
    fitted: np.ndarray | None


def matched_cohort(
    template: Mesh,
    meshes: Sequence[Mesh],
    match: MatchCases,
    groupwise: GroupwiseSettings | None = None,
    mean_of: Collection[str] | None = None,
) -> MatchedCohort:
    """Match a template to each case, and then the mean shape in rounds.

    Args:
        template: One of the cases.
        meshes: The surface of each case, in its own millimetres.
        match: `(round, case → start)` → a correspondence per case, in the same order. In round 0
            every start is None and the template is matched. In the others a start is `(V, 3)` mm,
            the mean shape on the template's faces, placed on the case.
        groupwise: How many rounds follow; None: none.
        mean_of: The cases that the means are made of; None: all.
    """
    matches = match(0, dict.fromkeys(mesh.case_id for mesh in meshes))
    shapes = collect(template, matches, meshes)
    rounds = groupwise or GroupwiseSettings(rounds=0)
    for number in range(1, rounds.rounds + 1):
        shapes, matches = groupwise_round(number, shapes, meshes, rounds, match, mean_of)
    return MatchedCohort(shapes, fitted_points(matches))


def fitted_points(matches: Sequence[Correspondence]) -> np.ndarray:
    """`(N, V, 3)` mm: the matched points before they were projected onto the surfaces."""
    return np.stack([match.fitted for match in matches])

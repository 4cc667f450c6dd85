"""A cohort's shapes against a design: tests, effects, maps and power, in order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import false_discovery_control

from ssm_pipeline.records import StudyError
from ssm_pipeline.shape_model.model import ShapeModel
from ssm_pipeline.statistics.covariates import Design
from ssm_pipeline.statistics.effects import (
    bootstrap_coefficients,
    coefficients,
    explained_share,
)
from ssm_pipeline.statistics.permutation import (
    mode_tests,
    multivariate_test,
    procrustes_test,
    vertex_test,
)
from ssm_pipeline.statistics.power import power_table

SHARE = 0.9  # of the variance, in the modes tested, where the cases carry so many
CASES_PER_MODE = 3


@dataclass(frozen=True, eq=False)
class VertexMap:
    """One column's effect on the mean shape, a step of it: displacement_mm (V, 3), and the
    permutation p-values (V,), as they are and q (V,) at a controlled false discovery rate."""

    name: str
    displacement_mm: np.ndarray
    p: np.ndarray
    q: np.ndarray


@dataclass(frozen=True, eq=False)
class ShapeComparison:
    """The result of `compare`.

    tests: A row per term: Hotelling's T² of the leading modes in standard deviations, and the F of
        Procrustes ANOVA of all modes in millimetres.
    modes: A row per column and mode. power: a row per column. maps: one per column.
    mode_count: How many leading modes `hotelling_t2` is of.
    """

    design: Design
    mode_count: int
    tests: pd.DataFrame
    modes: pd.DataFrame
    power: pd.DataFrame
    maps: tuple[VertexMap, ...]


def compare(
    model: ShapeModel,
    vertices: np.ndarray,
    design: Design,
    generator: np.random.Generator,
    mode_count: int | None = None,
    permutations: int = 4999,
    vertex_permutations: int = 999,
    draws: int = 1000,
) -> ShapeComparison:
    """Test every term of a design on the model's scores, and every column on each vertex.

    Args:
        vertices: (N, V, 3) mm: the model's cases, aligned, in the design's order.
        mode_count: None: as many as hold 90 % of the variance, at most a third of the cases that
            the design leaves. Raises StudyError for more than the cases carry.
        draws: Of the bootstrap.
    """
    matrix = design.matrix
    mode_count = modes_carried(model, matrix, mode_count)
    scores = model.scores[:, :mode_count]
    tests, modes, maps = [], [], []
    for term in design.terms:
        places = design.places(term)
        test = multivariate_test(scores, matrix, places, permutations, generator)
        in_mm = model.scores * model.standard_deviations
        whole = procrustes_test(in_mm, matrix, places, permutations, generator)
        tests.append(
            {
                "term": term,
                "cases": len(matrix),
                "modes": mode_count,
                "hotelling_t2": test.statistic,
                "hotelling_p": test.p,
                "procrustes_f": whole.statistic,
                "procrustes_df": whole.degrees[0],
                "procrustes_residual_df": whole.degrees[1],
                "procrustes_p": whole.p,
                "permutations": permutations,
                "explained_percent": 100 * explained_share(vertices, matrix, places),
            }
        )
    for column in design.columns:
        place, step = column.place, column.step
        p = mode_tests(scores, matrix, [place], permutations, generator)
        q = false_discovery_control(p)
        found = step * coefficients(scores, matrix)[place]
        low, high = bootstrap_coefficients(scores, matrix, place, draws, generator)
        modes += [
            {
                "effect": column.name,
                "mode": mode + 1,
                "change_sd": found[mode],
                "change_low_sd": step * low[mode],
                "change_high_sd": step * high[mode],
                "p": p[mode],
                "q": q[mode],
            }
            for mode in range(mode_count)
        ]
        at_vertices = vertex_test(vertices, matrix, [place], vertex_permutations, generator)
        maps.append(
            VertexMap(
                column.name,
                step * coefficients(vertices, matrix)[place],
                at_vertices,
                false_discovery_control(at_vertices),
            )
        )
    places_of = {column.name: (column.place, column.step) for column in design.columns}
    return ShapeComparison(
        design,
        mode_count,
        pd.DataFrame(tests),
        pd.DataFrame(modes),
        power_table(matrix, places_of, mode_count),
        tuple(maps),
    )


def modes_carried(model: ShapeModel, matrix: np.ndarray, wanted: int | None = None) -> int:
    """How many leading modes are tested together.

    Raises:
        StudyError: For more than is carried.
    """
    left = len(matrix) - matrix.shape[1]
    most = min(left // CASES_PER_MODE, model.mode_count)
    if most < 1:
        raise StudyError(
            f"{len(matrix)} cases and {matrix.shape[1]} columns of the design leave {left} degrees "
            f"of freedom; {CASES_PER_MODE} or more are needed for one mode. Add cases."
        )
    if wanted is None:
        result: int = min(model.modes_for(SHARE), most)
        return result
    if not 1 <= wanted <= most:
        raise StudyError(
            f"{wanted} modes can't be tested together with {len(matrix)} cases and "
            f"{matrix.shape[1]} columns of the design: {CASES_PER_MODE} cases a mode are needed, "
            f"so 1 to {most} modes."
        )
    return wanted

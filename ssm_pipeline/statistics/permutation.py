"""Permutation tests of linear models with covariates: Freedman and Lane's.

The residuals of the model without the columns in question are permuted. With the mean alone beside
them the test is exact; with covariates it is so in the limit (Winkler et al. 2014).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Test:
    """The result of a permutation test.

    statistic: Hotelling's T² of `multivariate_test`, F of `procrustes_test`.
    p: Its permutation p-value.
    permutations: How many there were.
    degrees: Degrees of freedom of the tested columns and of the residuals.
    """

    statistic: float
    p: float
    permutations: int
    degrees: tuple[int, int]


@dataclass(frozen=True, eq=False)
class _Split:
    """A design in two: nuisance projector, residuals of the data under it, and an orthonormal
    basis (N, q) of what the tested columns add."""

    nuisance: np.ndarray
    residuals: np.ndarray
    added: np.ndarray

    @property
    def degrees(self) -> tuple[int, int]:
        """Degrees of freedom of the tested columns and of the residuals."""
        count, tested = self.added.shape
        return tested, count - self.nuisance.shape[1] - tested

    def without_nuisance(self, values: np.ndarray) -> np.ndarray:
        result: np.ndarray = values - self.nuisance @ (self.nuisance.T @ values)
        return result

    def permuted(self, count: int, generator: np.random.Generator) -> Iterator[np.ndarray]:
        """The residuals as they are, then `count` times permuted and freed of the nuisance."""
        yield self.residuals
        for _ in range(count):
            order = generator.permutation(len(self.residuals))
            yield self.without_nuisance(self.residuals[order])


def _split(values: np.ndarray, matrix: np.ndarray, tested: list[int]) -> _Split:
    rest = np.delete(matrix, tested, axis=1)
    nuisance = np.linalg.qr(rest)[0]
    columns = matrix[:, tested]
    added = np.linalg.qr(columns - nuisance @ (nuisance.T @ columns))[0]
    return _Split(nuisance, values - nuisance @ (nuisance.T @ values), added)


def multivariate_test(
    scores: np.ndarray,
    matrix: np.ndarray,
    tested: list[int],
    permutations: int,
    generator: np.random.Generator,
) -> Test:
    """Test whether some columns of a design explain scores beyond the other columns.

    The statistic is Hotelling's T², N − P times the Hotelling–Lawley trace; of several columns
    Hotelling's generalised T². Of one column with two groups it is the two-sample T².

    Args:
        scores: (N, K), where K is less than N − P.
        matrix: (N, P), with a column of ones.
        tested: Places of the tested columns.

    >>> generator = np.random.default_rng(0)
    >>> group = np.repeat([0.0, 1.0], 20)
    >>> scores = generator.standard_normal((40, 3)) + 1.5 * group[:, None]
    >>> design = np.column_stack([np.ones(40), group])
    >>> multivariate_test(scores, design, [1], 199, generator).p
    0.005
    """
    split = _split(scores, matrix, tested)
    values = []
    for residuals in split.permuted(permutations, generator):
        explained = split.added.T @ residuals
        between = explained.T @ explained
        within = residuals.T @ residuals - between
        values.append(float(np.trace(np.linalg.solve(within, between))))
    observed, drawn = values[0], np.array(values[1:])
    between_df, within_df = split.degrees
    p = _p_value(observed, drawn)
    return Test(within_df * observed, p, permutations, (between_df, within_df))


def procrustes_test(
    scores_mm: np.ndarray,
    matrix: np.ndarray,
    tested: list[int],
    permutations: int,
    generator: np.random.Generator,
) -> Test:
    """Test whether some columns explain shapes, with equal weights for all coordinates.

    This is Procrustes ANOVA. The statistic is F, the explained over the residual mean square, with
    the degrees of freedom of the columns and of the residuals (as `procD.lm` of R's geomorph).
    `multivariate_test` is in standard deviations of a few modes; this test is in millimetres. It
    is stronger where large modes differ, and has no limit on the number of modes.

    Args:
        scores_mm: (N, M) scores of all modes in millimetres, which hold the shapes' distances from
            each other.
        matrix: (N, P), with a column of ones.
        tested: Places of the tested columns.

    Source: Goodall 1991; Anderson 2001 for the permutations.
    """
    split = _split(scores_mm, matrix, tested)
    values = []
    for residuals in split.permuted(permutations, generator):
        between = float(((split.added.T @ residuals) ** 2).sum())
        values.append(between / (float((residuals**2).sum()) - between))
    between_df, within_df = split.degrees
    p = _p_value(values[0], np.array(values[1:]))
    return Test(values[0] * within_df / between_df, p, permutations, (between_df, within_df))


def vertex_test(
    vertices: np.ndarray,
    matrix: np.ndarray,
    tested: list[int],
    permutations: int,
    generator: np.random.Generator,
) -> np.ndarray:
    """(V,) permutation p-values, vertex by vertex: the same test on the three coordinates of each.

    vertices (N, V, 3) mm, aligned. Correct them for their number (`false_discovery_control`).
    """
    count, vertex_count = vertices.shape[:2]
    split = _split(vertices.reshape(count, -1), matrix, tested)
    observed, exceeded = None, np.zeros(vertex_count)
    for residuals in split.permuted(permutations, generator):
        explained = (split.added.T @ residuals).reshape(-1, vertex_count, 3)
        between = np.einsum("qvd,qve->vde", explained, explained)
        spread = residuals.reshape(count, vertex_count, 3)
        within = np.einsum("nvd,nve->vde", spread, spread, optimize=True) - between
        ridge = 1e-12 * np.trace(within, axis1=1, axis2=2)[:, None, None] + 1e-12
        value = np.einsum("vde,ved->v", np.linalg.inv(within + ridge * np.eye(3)), between)
        if observed is None:
            observed = value
        else:
            exceeded += value >= observed * (1 - 1e-12)
    return (1 + exceeded) / (1 + permutations)


def mode_tests(
    scores: np.ndarray,
    matrix: np.ndarray,
    tested: list[int],
    permutations: int,
    generator: np.random.Generator,
) -> np.ndarray:
    """(K,) permutation p-values, mode by mode."""
    split = _split(scores, matrix, tested)
    observed, exceeded = None, np.zeros(scores.shape[1])
    for residuals in split.permuted(permutations, generator):
        between = ((split.added.T @ residuals) ** 2).sum(axis=0)
        value = between / np.maximum((residuals**2).sum(axis=0) - between, 1e-300)
        if observed is None:
            observed = value
        else:
            exceeded += value >= observed * (1 - 1e-12)
    return (1 + exceeded) / (1 + permutations)


def _p_value(observed: float, drawn: np.ndarray) -> float:
    """The share that is as large, the observed one counted (Phipson and Smyth 2010)."""
    return float((1 + (drawn >= observed * (1 - 1e-12)).sum()) / (1 + len(drawn)))

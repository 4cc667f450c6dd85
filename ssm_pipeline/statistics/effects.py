"""How large an effect is: least-squares coefficients, explained share, and bootstrap intervals."""

from __future__ import annotations

import numpy as np

LOWER, UPPER = 0.025, 0.975


def coefficients(values: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """(P, …) least-squares coefficients of values (N, …) on a design (N, P)."""
    flat = values.reshape(len(values), -1)
    solved = np.linalg.lstsq(matrix, flat, rcond=None)[0]
    result: np.ndarray = solved.reshape(matrix.shape[1], *values.shape[1:])
    return result


def explained_share(values: np.ndarray, matrix: np.ndarray, tested: list[int]) -> float:
    """Of the variance that the other columns leave, the share that the tested ones explain (partial
    R², over all coordinates together), 0 … 1.

    >>> group = np.repeat([0.0, 1.0], 5)
    >>> design = np.column_stack([np.ones(10), group])
    >>> explained_share(2 * group[:, None] - 1, design, [1])
    1.0
    """
    flat = values.reshape(len(values), -1)
    rest = np.delete(matrix, tested, axis=1)
    without = flat - rest @ coefficients(flat, rest)
    with_them = flat - matrix @ coefficients(flat, matrix)
    return float(1 - (with_them**2).sum() / max((without**2).sum(), 1e-300))


def bootstrap_coefficients(
    values: np.ndarray,
    matrix: np.ndarray,
    place: int,
    draws: int,
    generator: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """95 % intervals (K,), (K,) of one column's coefficients on values (N, K).

    Cases are drawn anew with what belongs to them, percentiles taken; a draw in which the design
    has lost a column (a group that was not drawn) is drawn again.
    """
    found: list[np.ndarray] = []
    while len(found) < draws:
        chosen = generator.integers(len(values), size=len(values))
        if np.linalg.matrix_rank(matrix[chosen]) < matrix.shape[1]:
            continue
        found.append(coefficients(values[chosen], matrix[chosen])[place])
    low, high = np.quantile(np.stack(found), [LOWER, UPPER], axis=0)
    return low, high

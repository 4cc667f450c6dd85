"""What this number of cases can show, and what it can't."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.optimize import brentq
from scipy.stats import f as central_f
from scipy.stats import ncf

LEVEL = 0.05
WANTED_POWER = 0.8
EFFECTS_SD = (0.2, 0.5, 0.8, 1.0, 1.5)  # Cohen's small, medium, large; and beyond


def power(
    effect_sd: float, matrix: np.ndarray, place: int, modes: int, level: float = LEVEL
) -> float:
    """The chance to find an effect of one column at a level, by the F test that Hotelling's T²
    follows for normal scores.

    Args:
        effect_sd: How far one step of the column moves the shape, in standard deviations of what
            the other columns leave (Mahalanobis), in any direction of the `modes` tested.

    >>> design = np.column_stack([np.ones(40), np.repeat([0.0, 1.0], 20)])
    >>> round(power(0.0, design, 1, 3), 6), power(1.5, design, 1, 3) > 0.95
    (0.05, True)
    """
    count, columns = matrix.shape
    within = count - columns - modes + 1
    if within < 1:
        return level
    rest = np.delete(matrix, place, axis=1)
    column = matrix[:, place]
    left = column - rest @ np.linalg.lstsq(rest, column, rcond=None)[0]
    noncentral = effect_sd**2 * float(left @ left)
    critical = central_f.isf(level, modes, within)
    return float(ncf.sf(critical, modes, within, noncentral)) if noncentral else level


def detectable_sd(matrix: np.ndarray, place: int, modes: int) -> float:
    """The effect that is found four times in five; infinite where no effect could be."""
    if power(100.0, matrix, place, modes) < WANTED_POWER:
        return float("inf")
    return float(brentq(lambda e: power(e, matrix, place, modes) - WANTED_POWER, 1e-6, 100.0))


def power_table(
    matrix: np.ndarray, places: dict[str, tuple[int, float]], modes: int
) -> pd.DataFrame:
    """A row per column: power for effects of several sizes, and the smallest that is found four
    times in five. places: name → (place, step): effects are those of one step."""
    rows = []
    for name, (place, step) in places.items():
        scaled = matrix.copy()
        scaled[:, place] /= step
        row: dict[str, object] = {"effect": name, "modes": modes}
        row |= {f"power_at_{size}_sd": power(size, scaled, place, modes) for size in EFFECTS_SD}
        row["found_4_in_5_sd"] = detectable_sd(scaled, place, modes)
        rows.append(row)
    return pd.DataFrame(rows)

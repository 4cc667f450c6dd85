"""Round numbers for scales that people read."""

from __future__ import annotations

import math

COARSE = (1, 2, 5)
FINE = (1, 1.5, 2, 2.5, 3, 4, 5, 6, 8)


def round_up(value: float, steps: tuple[float, ...] = COARSE) -> float:
    """The nearest number above a positive `value` that is one of `steps` times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(n * power for n in (*steps, 10) if n * power >= value * (1 - 1e-9))

"""Which cases each candidate for the template is tried on."""

from __future__ import annotations

import numpy as np


def partner_pairs(count: int, partners: int) -> list[tuple[int, int]]:
    """Unordered pairs (i < j) in which every one of `count` cases has about `partners` partners.

    Spread evenly over a fixed circle of the cases, so a cohort of hundreds costs no N² pairs.

    >>> partner_pairs(4, 2)
    [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    """
    offsets = np.unique(
        np.linspace(1, count // 2, min(partners // 2 + 1, count // 2)).round().astype(int)
    )
    pairs = {(min(i, j), max(i, j)) for i in range(count) for j in (i + offsets) % count}
    return sorted((int(i), int(j)) for i, j in pairs)

"""How many independent observations the points of a surface are worth."""

from __future__ import annotations

import numpy as np
from scipy.spatial.distance import pdist

BINS = 25


def independent_observations(points: np.ndarray, residuals: np.ndarray, area: float) -> float:
    """The number of patches of a surface whose residuals are independent of each other.

    points (K, 3), evenly spread over `area`; residuals (K,), any unit. What a model can't make is
    smooth, so that neighbours are wrong together: a thousand points are worth a hundred. Counted
    as the area over the integral of the residuals' autocorrelation, ∫ ρ(d) 2πd dd, up to where ρ
    first vanishes; between 1 and K.
    Source: the integral range of geostatistics (Lantuéjoul 2002, ch. 4).

    >>> grid = np.stack(np.meshgrid(range(20), range(20), [0]), -1).reshape(-1, 3) * 1.0
    >>> noise = np.random.default_rng(0).standard_normal(400)
    >>> independent_observations(grid, noise, 400.0) > 200
    True
    >>> independent_observations(grid, np.sin(grid[:, 0] / 4), 400.0) < 20
    True
    """
    residuals = residuals - residuals.mean()
    variance = float((residuals**2).mean())
    count = len(points)
    if count < 3 or variance == 0:
        return float(count)
    distances = pdist(points)
    first, second = np.triu_indices(count, 1)
    width = distances.max() / 2 / BINS
    bins = (distances / width).astype(np.int64)
    inside = bins < BINS
    pairs = np.bincount(bins[inside], minlength=BINS)
    product = (residuals[first] * residuals[second])[inside]
    sums = np.bincount(bins[inside], product, minlength=BINS)
    middles = (np.arange(BINS) + 0.5) * width
    # No two points are nearer than their spacing: from 1 at no distance, straight to the first.
    seen = pairs > 0
    places = np.concatenate([[0.0], middles[seen]])
    correlation = np.interp(
        middles, places, np.concatenate([[1.0], sums[seen] / pairs[seen] / variance])
    )
    vanished = np.flatnonzero(correlation <= 0)
    end = int(vanished[0]) if len(vanished) else BINS
    range_area = float((correlation * 2 * np.pi * middles)[:end].sum() * width)
    own = area / count  # a point stands for its own patch at least
    return float(np.clip(area / max(range_area, own), 1.0, count))

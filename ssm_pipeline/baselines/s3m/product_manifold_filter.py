"""One pass of the product manifold filter: a noisy map becomes a smooth bijection."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment


def filtered_bijection(
    y_to_x: np.ndarray, geodesic_x: np.ndarray, geodesic_y: np.ndarray
) -> np.ndarray:
    """The bijection y_to_x (n,) nearest to the given matches in the Gaussian-kernel density.

    Args:
        y_to_x: (n,) int, any map of Y's points to X's.
        geodesic_x: (n, n) distances on X, geodesic_y on Y, in standard deviations of the kernel.

    Source: Vestner et al. 2017, Eq. 8, one iteration.
    """
    if geodesic_x.shape != geodesic_y.shape:
        raise ValueError(
            f"distances have shapes {geodesic_x.shape} and {geodesic_y.shape}; a bijection needs "
            "as many points on both shapes"
        )
    K_x = np.exp(-0.5 * geodesic_x**2).astype(np.float32)
    K_y = np.exp(-0.5 * geodesic_y**2).astype(np.float32)
    density = K_y @ K_x[y_to_x]  # (n_y, n_x): Σ_p K_y(y, p) K_x(x, match of p)
    _, x_of_y = linear_sum_assignment(density, maximize=True)
    result: np.ndarray = x_of_y
    return result

"""The pose that a map of points describes, made as rigid as possible."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from ssm_pipeline.adaptation.distortion import Edges, best_rotations

ALTERNATIONS = 12
ROBUST_SCALE = 0.1  # √area: a target so far off counts a quarter


def map_start(
    rest: np.ndarray,
    targets: np.ndarray,
    laplacian: sp.csr_matrix,
    mass: np.ndarray,
    map_weight: float,
) -> np.ndarray:
    """(V, 3): the template near its targets, without the noise of the map.

    Minimises, over x and one rotation R_i per vertex,

        Σ_ij w_ij ‖R_i (r_i − r_j) − (x_i − x_j)‖² + μ Σ_i m_i c_i ‖x_i − g_i‖²,

    where c_i = 1 / (1 + (‖x_i − g_i‖ / 0.1)²)² belongs to the robust loss of Geman and McClure: a
    target that contradicts its surroundings loses its weight. Twelve alternations of the
    rotations, the weights c, and one sparse solve for x, from x = g and c = 1.

    Args:
        rest: (V, 3) the template r at unit area.
        targets: (V, 3) where the map sends each vertex, g, at unit area.
        laplacian: (V, V) of the template; off the diagonal it holds −w_ij.
        mass: (V,) areas m_i, of sum 1.
        map_weight: μ > 0. Noise of the map is smoothed over distances of about √(2 / μ).

    Source: Sorkine and Alexa 2007 for the first term; the robust targets are this project's.
    """
    edges = Edges.of(rest, laplacian)
    stiffness = edges.laplacian(len(rest))
    half = 0.5 * map_weight * mass  # half the gradient of each term is what is solved
    weak = 1e-9 * np.where(half > 0, half, half.mean())  # a vertex without a triangle has no mass
    x, robust = targets, np.ones(len(rest))
    for _ in range(ALTERNATIONS):
        pull = half * robust
        right = edges.divergence(best_rotations(edges, x)) + pull[:, None] * targets
        # Where every target lost its weight a piece could drift: keep the factor regular.
        regular = pull + weak
        factor = splu(
            (stiffness + sp.diags(regular)).tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        x = factor.solve(right + (regular - pull)[:, None] * x)
        gap = ((x - targets) ** 2).sum(axis=1)
        robust = 1 / (1 + gap / ROBUST_SCALE**2) ** 2
    return np.asarray(x)

"""Functional maps by unregularised least squares, and the points they match."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree


def functional_maps(coefficients_x: torch.Tensor, coefficients_y: torch.Tensor) -> torch.Tensor:
    """C_xy = argmin ‖C A − B‖², for a batch of pairs.

    coefficients_x (…, k, d) descriptors of X in its eigenfunctions (A); coefficients_y of Y (B). By
    Cholesky of the normal equations in float64: in float32 the squared condition number of hardly
    trained descriptors leaves no digit.

    Returns:
        (…, k, k).
    """
    A, B = coefficients_x.double(), coefficients_y.double()
    gram = A @ A.mT
    factor = torch.linalg.cholesky(gram)
    return torch.cholesky_solve(A @ B.mT, factor).mT.to(coefficients_x.dtype)


def nearest_in_spectrum(C_xy: np.ndarray, Phi_x: np.ndarray, Phi_y: np.ndarray) -> np.ndarray:
    """y_to_x (n_y,): for each point of Y the point of X whose mapped delta function is nearest.

    Phi_x (n_x, k), Phi_y (n_y, k) eigenvectors; C_xy (k, k). Source: Ovsjanikov et al. 2012.
    """
    _, y_to_x = cKDTree(Phi_x @ C_xy.T).query(Phi_y)
    return np.asarray(y_to_x, dtype=np.int64)

"""Coherent point drift, by the package rustcpd (the optional extra `rivals`)."""

from __future__ import annotations

import numpy as np

from ssm_pipeline.baselines.settings import RegistrationSettings
from ssm_pipeline.records import Mesh


def cpd_fitted(
    start: np.ndarray, faces: np.ndarray, case: Mesh, settings: RegistrationSettings
) -> np.ndarray:
    """(V, 3) mm: a template placed on the case, start (V, 3), moved to the case's vertices.

    A Gaussian mixture at the template's vertices explains the case's, under a Gaussian-process
    prior on the displacements. The faces are not looked at.

    Raises:
        ImportError: Where rustcpd is not installed.

    Source: Myronenko and Song 2010, "Point set registration: coherent point drift".
    """
    import rustcpd

    fitted = rustcpd.register_deformable(
        case.vertices,
        start,
        alpha=settings.cpd_strength,
        beta=settings.cpd_width,
        low_rank=min(settings.cpd_columns, len(start)),
        low_rank_method="pivoted_cholesky",
        normalize=True,
        max_iterations=settings.cpd_steps,
        outlier_weight=settings.cpd_outliers,
        parallel=False,
    )
    return np.asarray(fitted.points)

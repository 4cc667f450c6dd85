"""Non-rigid iterative closest points, as trimesh has it."""

from __future__ import annotations

import warnings

import numpy as np
import trimesh
from trimesh.registration import nricp_amberg

from ssm_pipeline.baselines.settings import RegistrationSettings
from ssm_pipeline.records import Mesh


def nricp_fitted(
    start: np.ndarray, faces: np.ndarray, case: Mesh, settings: RegistrationSettings
) -> np.ndarray:
    """(V, 3) mm: a template placed on the case, start (V, 3), deformed to fit it.

    Source: Amberg et al. 2007, "Optimal step nonrigid ICP".
    """
    steps = [
        (smoothness, 0.0, settings.nricp_normals, settings.nricp_steps)
        for smoothness in settings.nricp_smoothness
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of trimesh's own division for triangles without area
        return np.asarray(
            nricp_amberg(
                trimesh.Trimesh(start, faces, process=False),
                trimesh.Trimesh(case.vertices, case.faces, process=False),
                steps=steps,
                distance_threshold=np.inf,
            )
        )

"""A template matched to a case by one of the plain registrations."""

from __future__ import annotations

import importlib.util

import numpy as np

from ssm_pipeline.adaptation.carried_onto import carried_onto
from ssm_pipeline.baselines.common_start import rigid_start
from ssm_pipeline.baselines.settings import RegistrationSettings
from ssm_pipeline.records import Correspondence, Mesh

PACKAGES = {"cpd": "rustcpd"}  # of the optional extra `rivals`


def missing_package(registration: str) -> str | None:
    """The package that this registration needs, if it is not installed; else None.

    >>> missing_package("affine nearest") is None
    True
    """
    package = PACKAGES.get(registration)
    if package is None or importlib.util.find_spec(package) is not None:
        return None
    return package


def register(
    template: Mesh,
    case: Mesh,
    registration: str,
    settings: RegistrationSettings,
    start: np.ndarray | None,
    seed: int,
) -> Correspondence:
    """Match a template to a case.

    Args:
        template: The template's mesh.
        case: The case's mesh.
        registration: "affine nearest" (affine alignment, nearest point), "nricp" (non-rigid
            iterative closest points) or "cpd" (coherent point drift).
        settings: The settings of the registrations.
        start: `(V, 3)` mm, a shape on the template's faces already placed on the case, such as a
            cohort's mean. None: the template by `rigid_start`, as in every other row of a table.
        seed: Decides the points that are drawn.

    Returns:
        The correspondence.

    Raises:
        ValueError: There is no such registration.
    """
    if start is None:
        start = rigid_start(template, case, seed).apply(template.vertices)
    if registration == "affine nearest":
        from ssm_pipeline.baselines.affine_registration import affinely_aligned

        fitted = affinely_aligned(start, template.faces, case, settings, seed)
    elif registration == "nricp":
        from ssm_pipeline.baselines.nricp import nricp_fitted

        fitted = nricp_fitted(start, template.faces, case, settings)
    elif registration == "cpd":
        from ssm_pipeline.baselines.coherent_point_drift import cpd_fitted

        fitted = cpd_fitted(start, template.faces, case, settings)
    else:
        raise ValueError(f"there is no registration {registration!r}")
    return carried_onto(case, template.case_id, fitted, fitted)

"""The plain registrations: each finds what it can express, from the same start."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
from shapes import blob

from ssm_pipeline.baselines import register as registering
from ssm_pipeline.baselines.affine_registration import affinely_aligned
from ssm_pipeline.baselines.common_start import rigid_start
from ssm_pipeline.baselines.register import missing_package, register
from ssm_pipeline.baselines.settings import RegistrationSettings
from ssm_pipeline.methods import base_methods
from ssm_pipeline.records import Mesh

SETTINGS = RegistrationSettings(affine_points=1500, nricp_smoothness=(1e-1, 1e-2))


def bent(mesh: Mesh) -> Mesh:
    """The solid wider, shorter and bent: part of it affine, part not."""
    points = mesh.vertices.copy()
    points[:, 0] += 0.002 * points[:, 2] ** 2
    return Mesh(points * [1, 1.3, 1 / 1.3], mesh.faces, "case")


def test_affine_alignment_finds_an_affine_map() -> None:
    template = blob(1, faces=500)
    A = np.array([[1.15, 0.05, 0.0], [0.0, 0.9, 0.1], [0.04, 0.0, 1.05]])
    other = blob(1, faces=400)
    case = Mesh(other.vertices @ A.T + 7, other.faces, "case")
    found = affinely_aligned(template.vertices + 7, template.faces, case, SETTINGS, 0)
    off = np.linalg.norm(found - (template.vertices @ A.T + 7), axis=1)
    assert off.mean() < 1.5  # of about 100 mm; before: 5.4


@pytest.mark.parametrize("registration", base_methods("registration"))
def test_each_comes_nearer_to_the_truth_than_its_start(registration: str) -> None:
    if missing_package(registration):
        pytest.skip(f"{missing_package(registration)} is not installed")
    template, case = blob(2, faces=400), bent(blob(2, faces=350))
    truth = bent(template).vertices
    match = register(template, case, registration, SETTINGS, None, seed=0)
    start = rigid_start(template, case, seed=0).apply(template.vertices)
    error = np.linalg.norm(match.points_on(case) - truth, axis=1).mean()
    assert error < 0.8 * np.linalg.norm(start - truth, axis=1).mean()
    assert match.template_id == "blob2"
    assert match.case_id == "case"
    assert match.fitted.shape == template.vertices.shape
    assert (match.barycentric >= 0).all()  # on the case's triangles
    assert match.barycentric.sum(axis=1) == pytest.approx(1)


def test_a_given_start_is_where_it_starts() -> None:
    template, case = blob(2, faces=400), bent(blob(2, faces=500))
    near = register(template, case, "affine nearest", SETTINGS, bent(template).vertices, 0)
    truth = bent(template).vertices
    assert np.linalg.norm(near.fitted - truth, axis=1).mean() < 1.5


def test_a_package_that_is_absent_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert registering.missing_package("cpd") == "rustcpd"
    assert registering.missing_package("nricp") is None


def test_an_unknown_registration_is_refused() -> None:
    mesh = blob(1, faces=60)
    with pytest.raises(ValueError, match="no registration 'icp'"):
        register(mesh, mesh, "icp", SETTINGS, mesh.vertices, 0)

"""What is done to one case, in a process of its own: read files, call one room, write files."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ssm_pipeline import storage
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.meshing.settings import MeshingSettings
from ssm_pipeline.pipeline.per_case import Row
from ssm_pipeline.records import CaseSource, Correspondence, Mesh, SpectralBasis
from ssm_pipeline.spectral.settings import SpectralSettings

if TYPE_CHECKING:  # at run time inside the functions: not every worker needs PyTorch
    from ssm_pipeline.adaptation.correspond import Method


def mesh_case(case: CaseSource, settings: MeshingSettings, folder: Path) -> Row:
    """mesh.npz; the row is its quality and the mask's warnings."""
    from ssm_pipeline.meshing.mask_to_mesh import mesh_from_mask

    mask = case.load()
    mesh, quality = mesh_from_mask(mask, settings)
    storage.save(mesh, folder / "mesh.npz")
    remarks = {"warnings": "; ".join(mask.warnings)}
    return {"case_id": case.case_id, **dataclasses.asdict(quality), **remarks}


def basis_case(
    mesh_path: Path, settings: SpectralSettings, training_faces: int, folder: Path
) -> Row:
    """basis.npz of the mesh, and training_basis.npz of the coarser one that is trained on."""
    from ssm_pipeline.meshing.decimation import decimate
    from ssm_pipeline.spectral.basis import spectral_basis

    mesh = storage.load(Mesh, mesh_path)
    coarse = decimate(mesh, training_faces)
    basis, training_basis = spectral_basis(mesh, settings), spectral_basis(coarse, settings)
    storage.save(basis, folder / "basis.npz")
    storage.save(training_basis, folder / "training_basis.npz")
    return {
        "case_id": mesh.case_id,
        "vertices": len(mesh.vertices),
        "training_vertices": len(coarse.vertices),
        "first_eigenvalue": float(basis.eigenvalues[1]),
        "last_eigenvalue": float(basis.eigenvalues[-1]),
    }


def correspond_case(
    template_path: Path,
    case_path: Path,
    matcher_path: Path | None,
    settings: AdaptationSettings,
    method: Method,
    with_path: bool,
    folder: Path,
) -> Row:
    """correspondence.npz, and path.npz where one is wanted."""
    from ssm_pipeline.adaptation.correspond import correspond
    from ssm_pipeline.adaptation.path import shape_path
    from ssm_pipeline.training.matcher import load_matcher

    template = storage.load(SpectralBasis, template_path)
    case = storage.load(SpectralBasis, case_path)
    matcher, coarse = None, None
    if matcher_path is not None:
        matcher = load_matcher(matcher_path)
        coarse = (
            storage.load(SpectralBasis, template_path.with_name("training_basis.npz")),
            storage.load(SpectralBasis, case_path.with_name("training_basis.npz")),
        )
    match: Correspondence = correspond(template, case, matcher, settings, method, coarse)
    storage.save(match, folder / "correspondence.npz")
    if with_path and matcher is not None:
        path = shape_path(template, case, matcher, settings, coarse)
        storage.save(path, folder / "path.npz")
    return {"case_id": case.case_id, "template_id": template.case_id}


def readapt_case(
    start: np.ndarray,
    template_path: Path,
    case_path: Path,
    settings: AdaptationSettings,
    folder: Path,
) -> Row:
    """correspondence.npz of a shape on the template's faces, laid on the case: (V, 3) mm."""
    from ssm_pipeline.adaptation.correspond import correspond_again

    template = storage.load(SpectralBasis, template_path)
    case = storage.load(SpectralBasis, case_path)
    match = correspond_again(start, template, case, settings)
    storage.save(match, folder / "correspondence.npz")
    return {"case_id": case.case_id, "template_id": template.case_id}

"""Stage `spectral`: every surface to its Laplacian eigenbasis, twice: as it is and coarser."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from ssm_pipeline import storage
from ssm_pipeline.engine.per_case import CaseTask, Row
from ssm_pipeline.engine.stage import Outcome
from ssm_pipeline.runs.context import Context, run_of
from ssm_pipeline.runs.layout import BASIS, MESH, TRAINING_BASIS
from ssm_pipeline.spectral.settings import SpectralSettings


def make_bases(context: Context) -> Outcome:
    """<case>/basis.npz and <case>/training_basis.npz; spectra.csv."""
    run, settings = run_of(context), context.settings.spectral
    faces = context.settings.training.faces
    results = context.map_cases(
        [
            CaseTask(
                case_id,
                context.case_key(case_id, settings, faces),
                partial(basis_case, run.finished(MESH, case_id), settings, faces),
            )
            for case_id in context.case_keys
        ]
    )
    context.write_table("spectra", [result.row for result in results if not result.dropped])
    return context.outcome(results)


def basis_case(
    mesh_path: Path, settings: SpectralSettings, training_faces: int, folder: Path
) -> Row:
    """basis.npz of the mesh, and training_basis.npz of the coarser one that is trained on."""
    from ssm_pipeline.meshing.decimation import decimate
    from ssm_pipeline.spectral.basis import spectral_basis

    mesh = MESH.read(mesh_path)
    coarse = decimate(mesh, training_faces)
    basis, training_basis = spectral_basis(mesh, settings), spectral_basis(coarse, settings)
    storage.save(basis, folder / BASIS.name)
    storage.save(training_basis, folder / TRAINING_BASIS.name)
    return {
        "case_id": mesh.case_id,
        "vertices": len(mesh.vertices),
        "training_vertices": len(coarse.vertices),
        "first_eigenvalue": float(basis.eigenvalues[1]),
        "last_eigenvalue": float(basis.eigenvalues[-1]),
    }

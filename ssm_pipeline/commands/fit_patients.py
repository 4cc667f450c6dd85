"""`workflow fit`: fit the model to patients who are not in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ssm_pipeline import storage
from ssm_pipeline.commands.export_folder import note_export
from ssm_pipeline.counting import counted
from ssm_pipeline.data_prep.cohorts.patient_files import patient_files
from ssm_pipeline.data_prep.cohorts.patients import advice_on_patients
from ssm_pipeline.engine.keys import key_of, key_of_arrays
from ssm_pipeline.engine.terminal import Terminal
from ssm_pipeline.fitting.cross_validation import (
    FEWEST_CASES,
    CrossValidation,
    can_judge,
    cross_validate,
)
from ssm_pipeline.fitting.partial import opened_at_image_border
from ssm_pipeline.fitting.patient import FitReport, fit_patient
from ssm_pipeline.fitting.yardstick import Yardstick, drawn_cases, meshes_of
from ssm_pipeline.records import (
    CaseError,
    CorrespondedShapes,
    Correspondence,
    Dropped,
    Mask,
    Mesh,
    StudyError,
    Surface,
)
from ssm_pipeline.runs.layout import MATCHER
from ssm_pipeline.runs.run import Run, load_run
from ssm_pipeline.study.new_patient import AS_THE_STUDY, HowToRead, read_patient
from ssm_pipeline.study.settings import StudySettings
from ssm_pipeline.study.study import read_run_settings

WAYS = ("model", "matcher")
FITS_FILE = "fits.csv"


def fit_patients(
    run_folder: Path,
    files: Sequence[Path],
    folder: Path,
    by: str = "model",
    how: HowToRead = AS_THE_STUDY,
    jobs: int = 1,
    terminal: Terminal | None = None,
) -> list[FitReport]:
    """Fit every patient, and write tables, surfaces and a page to `folder`.

    A file that can't be used is left out. The terminal, `fits.csv` and the page say why.

    Args:
        files: Masks and surfaces, and folders: every mask and surface below them.
        folder: It must not hold the results of an earlier call.
        by: One of `WAYS`.
        how: What is other about these files than about those of the study.

    Raises:
        StudyError: If no patient could be fitted, two files have one id, or `folder` holds the
            results of an earlier call.
    """
    terminal = terminal or Terminal()
    run, settings = load_run(run_folder), read_run_settings(run_folder)
    if by not in WAYS:
        raise StudyError(f"--by {by}: {' or '.join(WAYS)} is needed.")
    _refuse_former_fits(folder)
    found = patient_files(files)
    left_out = list(found.left_out)
    for dropped in left_out:
        terminal.say(f"left out {dropped.case_id}: {dropped.reason}")
    if advice := advice_on_patients(run.patients):
        terminal.say(advice)
    shapes, meshes, patients = cases_to_judge_by(run, settings, terminal)
    reference = reference_of(run, shapes, meshes, patients, settings, jobs, terminal)
    with_scale = settings.shape_model.with_scale
    yardstick = Yardstick(run.model, shapes, meshes, reference, with_scale, patients)
    fits: list[FitReport] = []
    for case_id, path in found.files.items():
        try:
            patient = read_patient(path, settings.data, how, case_id)
            surface = patient_surface(patient, settings)
            matched = matched_to_template(run, settings, surface) if by == "matcher" else None
            fit = fit_patient(yardstick, surface, matched, settings.seed, jobs)
        except CaseError as error:
            terminal.say(f"left out {case_id}: {error.reason}")
            left_out.append(Dropped(case_id, "fit", error.reason))
            continue
        fits.append(fit)
        terminal.say(
            f"{fit.case_id}   {fit.mean_mm:.2f} mm   HD95 {fit.hd95_mm:.2f} mm   "
            f"{fit.typicality.mahalanobis.value:.1f} SD from the mean"
        )
        for line in (*fit.typicality.flags, *fit.remarks):
            terminal.detail(f"{line}")
    if not fits:
        raise StudyError("no patient could be fitted; the lines above say why.")
    if left_out:
        of = counted(len(fits) + len(left_out), "patient")
        terminal.say(f"{len(left_out)} of {of} left out: fits.csv and the page say why")
    from ssm_pipeline.export.fits import write_fits
    from ssm_pipeline.report.fit_page import write_fit_page

    note_export(run_folder, folder)  # it names the cases: `workflow forget` tells of it
    write_fits(fits, folder, reflected=how.mirror, left_out=left_out)
    drawn = 0 if shapes.case_ids == run.shapes.case_ids else len(shapes.case_ids)
    write_fit_page(
        fits,
        folder / "index.html",
        run.folder.resolve().name,
        settings.is_synthetic,
        drawn=drawn,
        left_out=left_out,
    )
    return fits


def cases_to_judge_by(
    run: Run, settings: StudySettings, terminal: Terminal
) -> tuple[CorrespondedShapes, list[Mesh], list[str]]:
    """Return the run's cases, their meshes and their patients.

    If there are too few cases, shapes drawn from the model are returned instead.
    """
    shapes, model, patient_of = run.shapes, run.model, run.patients
    patients = [patient_of[case_id] for case_id in shapes.case_ids]
    if can_judge(patients):
        return shapes, [run.mesh(case_id) for case_id in shapes.case_ids], patients
    drawn = drawn_cases(model, settings.seed)
    terminal.say(
        f"the model has {counted(len(shapes.case_ids), 'case')} of "
        f"{counted(len(set(patients)), 'patient')}, but {FEWEST_CASES} or more are needed to judge "
        f"a fit. {len(drawn.case_ids)} shapes drawn from the model are used instead. They vary "
        "less than patients, so thresholds and intervals are too narrow."
    )
    return drawn, meshes_of(drawn), list(drawn.case_ids)


def reference_of(
    run: Run,
    shapes: CorrespondedShapes,
    meshes: Sequence[Mesh],
    patients: Sequence[str],
    settings: StudySettings,
    jobs: int,
    terminal: Terminal,
) -> CrossValidation:
    """Return the cross-validation of a run's model; it is computed once, in `<run>/fitting/`."""
    surfaces = [key_of_arrays(mesh.vertices, mesh.faces) for mesh in meshes]
    matched = key_of_arrays(shapes.vertices)
    key = key_of(matched, surfaces, list(patients), settings.shape_model, settings.seed)
    path = run.folder / "fitting" / f"cross_validation-{key[:12]}.npz"
    if path.is_file():
        return storage.load(CrossValidation, path)
    terminal.say(
        f"fitting {counted(len(shapes.case_ids), 'case')}, each left out of the model (done once)"
    )
    with_scale = settings.shape_model.with_scale
    reference = cross_validate(shapes, meshes, with_scale, settings.seed, jobs, patients)
    storage.save(reference, path)
    return reference


def patient_surface(patient: Mask | Surface, settings: StudySettings) -> Mesh:
    """Return a mask's surface, open at the image border; a surface is returned as it is."""
    if isinstance(patient, Surface):
        return Mesh(patient.vertices, patient.faces, patient.case_id)
    from ssm_pipeline.meshing.mask_to_mesh import mesh_with_quality

    mesh, quality = mesh_with_quality(patient, settings.meshing)
    margin = 2 * quality.smoothing_mm + quality.voxel_mm
    return opened_at_image_border(mesh, patient, margin)


def matched_to_template(run: Run, settings: StudySettings, surface: Mesh) -> np.ndarray:
    """(V, 3) mm: the surface where the template's vertices are, by the network, adaptation, and the
    study's groupwise rounds, of the run's own cases.

    Raises:
        CaseError: For an open surface.
    """
    from ssm_pipeline.adaptation.correspond import correspond_again, correspond_bases
    from ssm_pipeline.geometry.topology import is_oriented_manifold
    from ssm_pipeline.meshing.decimation import decimate
    from ssm_pipeline.shape_model.groupwise_rounds import groupwise_rounds
    from ssm_pipeline.spectral.basis import spectral_basis
    from ssm_pipeline.training.matcher import load_matcher

    if not is_oriented_manifold(surface.faces):
        raise CaseError(
            surface.case_id,
            "the surface is open or not a manifold, so it can't be matched. Pass --by model.",
        )
    matcher_file = run.where(MATCHER)
    if not matcher_file.is_file():
        raise StudyError(f"{run.folder} has no trained matcher. Pass --by model.")
    shapes = run.shapes
    if surface.case_id in shapes.case_ids:  # a case of the model, fitted as if it were new
        surface = Mesh(surface.vertices, surface.faces, f"{surface.case_id}, fitted again")
    (template, of_template), (patient, of_patient) = (
        (
            spectral_basis(mesh, settings.spectral),
            spectral_basis(decimate(mesh, settings.training.faces), settings.spectral),
        )
        for mesh in (run.mesh(run.template_id), surface)
    )
    match = correspond_bases(
        template,
        patient,
        load_matcher(matcher_file),
        settings.adaptation,
        coarse=(of_template, of_patient),  # as dense as the networks were trained on
        seed=settings.seed,
    )

    def match_patient(number: int, starts: Mapping[str, np.ndarray]) -> list[Correspondence]:
        start = starts[surface.case_id]
        return [correspond_again(start, template, patient, settings.adaptation, settings.seed)]

    with_patient = CorrespondedShapes(
        np.concatenate([shapes.vertices, match.points_on(surface)[None]]),
        shapes.faces,
        (*shapes.case_ids, surface.case_id),
        shapes.template_id,
    )
    rounds = settings.groupwise
    result: np.ndarray = groupwise_rounds(
        with_patient, [surface], rounds, match_patient, mean_of=shapes.case_ids
    ).vertices[-1]
    return result


def _refuse_former_fits(folder: Path) -> None:
    """Results of two calls in one folder would be listed only in part: one folder for each call."""
    if (folder / FITS_FILE).exists():
        raise StudyError(
            f"{folder} holds the results of an earlier fit ({FITS_FILE}). Give all patients in one "
            f"call, choose another folder with --out, or delete {folder} first."
        )

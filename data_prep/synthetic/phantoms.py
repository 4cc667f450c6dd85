"""Synthetic cohorts: a folder of label images with exact correspondences beside them.

The families `lung` and `tube` are `phantom.000.mha` … with labels 1 and 2, the two parts of the
organ; `smooth` reads like a LUNA16 download. `truth.npz` holds the truth, `phantoms.json` what made
the folder and how much of the cohort's variance is affine.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import SimpleITK as sitk

from ssm_pipeline import storage
from ssm_pipeline.data_prep.cohorts import luna16, mask_folder
from ssm_pipeline.data_prep.cohorts.selection import Choice
from ssm_pipeline.data_prep.synthetic import smooth_phantoms
from ssm_pipeline.data_prep.synthetic.phantom_cases import draw_cases, family_named, scan, truth_of
from ssm_pipeline.data_prep.synthetic.phantom_settings import PhantomSettings
from ssm_pipeline.geometry.affine import affine_share
from ssm_pipeline.records import Cohort, PhantomTruth, StudyError

GENERATOR_VERSION = 3  # raise it when the same settings give other phantoms
_SETTINGS_FILE, _TRUTH_FILE = "phantoms.json", "truth.npz"


def make_cohort(folder: Path, settings: PhantomSettings | None = None) -> Cohort:
    """Write the phantoms to `folder` and return them with their truth.

    The same settings give the same bytes; a folder that already holds them is read, not written.

    Raises:
        StudyError: If the folder holds files of another kind.
    """
    settings = settings or PhantomSettings()
    stated = {"generator_version": GENERATOR_VERSION, "settings": settings.model_dump(mode="json")}
    marker = folder / _SETTINGS_FILE
    if marker.is_file():
        found = storage.read_json(marker)
        if {name: found.get(name) for name in stated} == stated:
            return read_cohort(folder)
        marker.unlink()  # first, so that a half-written folder is never taken for a whole one
        for path in folder.glob("phantom.*"):
            path.unlink()
    elif any(not path.name.startswith("phantom.") for path in folder.glob("*.mh[ad]")):
        raise StudyError(
            f"{folder} holds masks that are not phantoms. Give an empty or a new folder."
        )
    folder.mkdir(parents=True, exist_ok=True)
    truth = _write_scans(folder, settings)
    storage.save(truth, folder / _TRUTH_FILE)
    stated["affine_share"] = round(affine_share(truth.vertices), 4)
    storage.write_json(marker, stated)
    return read_cohort(folder)


def read_cohort(folder: Path) -> Cohort:
    """The organs of a phantom folder, with their truth.

    Raises:
        StudyError: Without one.
    """
    path, marker = folder / _TRUTH_FILE, folder / _SETTINGS_FILE
    if not (path.is_file() and marker.is_file()):
        raise StudyError(f"{folder} holds no finished phantom cohort. Make it with make_cohort.")
    truth = storage.load(PhantomTruth, path)
    if truth.labels is None:
        scans = luna16.find_cases(folder, side="left", choice=Choice(truth.case_ids))
    else:
        family = storage.read_json(marker)["settings"]["family"]
        organ = mask_folder.Organ((1, 2), name=family_named(family).organ)
        scans = mask_folder.find_cases(folder, organ, choice=Choice(truth.case_ids))
    return replace(scans, name="phantoms", truth=truth)


def draw_truth(settings: PhantomSettings) -> PhantomTruth:
    """The true surfaces alone, without scans of them.

    >>> truth = draw_truth(PhantomSettings(family="smooth", cases=2))
    >>> truth.vertices.shape
    (2, 10242, 3)
    """
    if settings.family == "smooth":
        return smooth_phantoms.draw(settings)[0]
    family = family_named(settings.family)
    return truth_of(family, draw_cases(family, settings), settings)


def _write_scans(folder: Path, settings: PhantomSettings) -> PhantomTruth:
    if settings.family == "smooth":
        truth, right_lungs = smooth_phantoms.draw(settings)
        for case_id, left, right in zip(truth.case_ids, truth.vertices, right_lungs, strict=True):
            image = smooth_phantoms.scan(left, right, truth.faces, settings)
            _write(image, folder / f"{case_id}.mhd")
        return truth
    family = family_named(settings.family)
    cases = draw_cases(family, settings)
    truth = truth_of(family, cases, settings)
    for case_id, case in zip(truth.case_ids, cases, strict=True):
        image = scan(family, case, settings.voxel_noise)
        _write(image, folder / f"{case_id}.mha")
    return truth


def _write(image: sitk.Image, path: Path) -> None:
    """The image, and for .mhd its voxels beside it.

    Raises:
        StudyError: Where the disk refuses.
    """
    try:
        sitk.WriteImage(image, str(path), useCompression=True)
    except RuntimeError as error:  # ITK's only kind
        reason = str(error).strip().splitlines()[-1].removeprefix("Reason: ")
        raise StudyError(
            f"{path} can't be written: {reason}. Free some space, or choose another folder."
        ) from error
    for written in path.parent.glob(f"{path.stem}.*"):
        storage.reach_disk(written)

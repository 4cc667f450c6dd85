"""Files of new patients, from files and folders that a user gives: an id for each."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ssm_pipeline.data_prep.cohorts.case_names import told_apart
from ssm_pipeline.data_prep.cohorts.selection import why_unusable
from ssm_pipeline.data_prep.formats.image_files import image_stem, is_image
from ssm_pipeline.data_prep.formats.segments import is_segmentation
from ssm_pipeline.data_prep.formats.surface_files import (
    SUFFIXES,
    SURFACE_FORMATS,
    is_surface,
    surface_stem,
)
from ssm_pipeline.records import Dropped, StudyError


@dataclass(frozen=True)
class PatientFiles:
    """Files that can be read, by id, and those that cannot be used, each with its reason."""

    files: dict[str, Path]
    left_out: tuple[Dropped, ...]


def patient_files(given: Sequence[Path]) -> PatientFiles:
    """The files given, and the masks and surfaces below the folders given, with their ids.

    The id is the name of the file without its suffix. Where all files have the same name, the id
    is the part of the path that differs.

    Raises:
        StudyError: For a folder without masks and surfaces, or two files with one id.
    """
    # A link keeps its own name, which `Path.resolve` would replace.
    absolute = [Path(os.path.abspath(file)) for file in _listed(given)]  # noqa: PTH100
    files = list(dict.fromkeys(absolute))
    ids = told_apart([_stem(file) for file in files], files)
    if doubled := sorted({name for name in ids if ids.count(name) > 1}):
        same = [str(file) for file, name in zip(files, ids, strict=True) if name == doubled[0]]
        raise StudyError(
            f"two files are called {', '.join(doubled)}: {same[0]} and {same[1]}; results are kept "
            "by that name. Rename one, give only files with equal names (as p*/liver.nii.gz: then "
            "the folders tell them apart), or fit them one after the other, each into its own "
            "folder (--out)."
        )
    usable, left_out = {}, []
    for case_id, file in zip(ids, files, strict=True):
        if reason := why_unusable(case_id, [file]):
            left_out.append(Dropped(case_id, "fit", reason))
        else:
            usable[case_id] = file
    return PatientFiles(usable, tuple(left_out))


def _listed(given: Sequence[Path]) -> list[Path]:
    """The files, with each folder replaced by the masks and surfaces below it, sorted."""
    listed: list[Path] = []
    for path in given:
        if not path.is_dir():
            listed.append(path)
            continue
        below = sorted(file for file in path.rglob("*") if _is_shape(file))
        if not below:
            raise StudyError(
                f"{path} holds no mask and no surface. Give files, or a folder with label images, "
                f"segmentations or surfaces ({SURFACE_FORMATS}) at any depth."
            )
        listed += below
    return listed


def _is_shape(path: Path) -> bool:
    return is_image(path) or is_surface(path) or is_segmentation(path)


def _stem(path: Path) -> str:
    is_named = path.suffix.lower() in SUFFIXES  # also where there is no such file
    return surface_stem(path) if is_named or is_surface(path) else image_stem(path)

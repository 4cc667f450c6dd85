"""LUNA16's lung masks: `<seriesuid>.mhd` + `.zraw`, labels 3 = left lung and 4 = right lung.

Source: Setio et al. 2017, https://luna16.grand-challenge.org.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from ssm_pipeline.data_prep.cohorts.selection import ALL, Choice, choose, cohort_of, unique_by_id
from ssm_pipeline.data_prep.cohorts.sides import load_mirrored
from ssm_pipeline.data_prep.formats.image_files import image_stem, image_suffix, is_image
from ssm_pipeline.data_prep.formats.images import read_labels
from ssm_pipeline.data_prep.formats.label_images import LabelImage
from ssm_pipeline.data_prep.formats.organ_masks import mask_diagonal, select_labels
from ssm_pipeline.data_prep.formats.organ_size import check_size
from ssm_pipeline.records import CaseSource, Cohort, Mask, StudyError, Surface

Side = Literal["left", "right", "both"]
LEFT, RIGHT = 3, 4
MASK_FOLDER = "seg-lungs-LUNA16"


def find_cases(
    folder: Path,
    side: Side = "left",
    subset: int | None = None,
    allow_truncated: bool = True,
    choice: Choice = ALL,
) -> Cohort:
    """The lung masks of a LUNA16 download; nothing is read before a case is loaded.

    Args:
        folder: Holds the masks, or a `seg-lungs-LUNA16` folder with them.
        side: `both` makes two cases of each scan, `<seriesuid>.left` and `<seriesuid>.right`.
        subset: Keeps the scans whose CT lies in `subset<k>/*.mhd` beside the masks' folder.
        choice: Of series UIDs; limit counts scans. mirror is of `both`; exclude names a case, or a
            series UID for both its sides.

    Raises:
        StudyError: For a folder without masks, a missing subset, an unknown or doubled case.
    """
    masks = _mask_folder(folder)
    files = [path for path in masks.iterdir() if is_image(path)]
    by_id = unique_by_id((image_stem(path), path) for path in files)
    if not by_id:
        raise StudyError(
            f"there are no masks (<seriesuid>.mhd with .zraw) in {masks}. Give the folder of "
            f"LUNA16's {MASK_FOLDER}, or the one it lies in."
        )
    if subset is not None:
        scans = _scans_of_subset(masks, subset)
        by_id = {uid: path for uid, path in by_id.items() if uid in scans}
        if not by_id:
            raise StudyError(f"none of the masks in {masks} belongs to a CT of subset{subset}.")
    sides: tuple[Side, ...] = ("left", "right") if side == "both" else (side,)
    sources = []
    for uid, path in choose(by_id, choice).items():
        for one in sides:
            case_id = f"{uid}.{one}" if side == "both" else uid
            load: Callable[[], Mask | Surface]
            load = partial(_load, path, one, case_id, allow_truncated)
            if one == choice.mirror:
                load = partial(load_mirrored, load)
            sources.append(CaseSource(case_id, _files_of(path), load, patient=uid))
    return cohort_of("luna16", sources, choice)


def _load(path: Path, side: Side, case_id: str, allow_truncated: bool) -> Mask:
    image = read_labels(path, case_id)
    label = LEFT if side == "left" else RIGHT
    mask = select_labels(image, (label,), f"{side} lung", allow_truncated)
    check_size(mask_diagonal(mask), case_id, f"the {side} lung in {path.name}")
    if _sides_swapped(image):
        warning = (
            f"label {LEFT} (left lung) lies to the patient's right of label {RIGHT}: the sides "
            "may be swapped"
        )
        return replace(mask, warnings=(*mask.warnings, warning))
    return mask


def _sides_swapped(image: LabelImage) -> bool:
    """True if both lungs are there and the left one's centre is not the more leftward (+x)."""
    centres = []
    for label in (LEFT, RIGHT):
        selected = image.labels[::4, ::4, ::4] == label  # a centre needs no more
        if not selected.any():
            return False
        index_zyx = np.argwhere(selected).mean(axis=0)
        centres.append(image.direction @ (index_zyx[::-1] * image.spacing_mm))
    return bool(centres[0][0] <= centres[1][0])


def _mask_folder(folder: Path) -> Path:
    inner = folder / MASK_FOLDER
    if inner.is_dir():
        return inner
    if not folder.is_dir():
        raise StudyError(
            f"there is no folder {folder}. Give the folder that holds LUNA16's {MASK_FOLDER}."
        )
    return folder


def _scans_of_subset(masks: Path, subset: int) -> set[str]:
    name = f"subset{subset}"
    for place in (masks.parent / name, masks / name):
        if place.is_dir():
            return {image_stem(path) for path in place.glob("*.mhd")}
    raise StudyError(
        f"subset {subset} was asked for and there is no folder {masks.parent / name}. Put "
        f"LUNA16's {name} (its CTs tell which scans belong to it) beside {masks.name}, or name "
        "the cases."
    )


def _files_of(path: Path) -> tuple[Path, ...]:
    """The header and, where it is apart, the file with the voxels."""
    if image_suffix(path) != ".mhd":
        return (path,)
    for line in path.read_text(encoding="latin-1").splitlines():
        key, _, value = line.partition("=")
        data = path.parent / value.strip()
        if key.strip() == "ElementDataFile" and data.is_file():
            return (path, data)
    return (path,)

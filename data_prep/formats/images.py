"""Label image → Mask, in patient space (LPS, mm)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import SimpleITK as sitk

from ssm_pipeline.data_prep.formats.image_files import check_header, check_voxels, stated_unit
from ssm_pipeline.data_prep.formats.image_memory import needed_gb, needed_gb_of, refuse_too_large
from ssm_pipeline.data_prep.formats.label_images import LabelImage, place, scaled
from ssm_pipeline.data_prep.formats.nifti import NiftiFile
from ssm_pipeline.data_prep.formats.organ_masks import mask_diagonal, select_labels
from ssm_pipeline.data_prep.formats.organ_size import MM_OF, Unit, check_size
from ssm_pipeline.records import CaseError, Mask


def read_labels(path: Path, case_id: str, unit: Unit | None = None) -> LabelImage:
    """Read `.mhd`, `.mha`, `.nrrd`, `.nii` or `.nii.gz`, in mm LPS.

    Args:
        unit: Of the file's lengths. None: what the file states, else millimetres.

    Raises:
        CaseError: the file is missing, damaged, not 3D, or without a usable spacing.
    """
    if not path.is_file():
        raise CaseError(case_id, f"there is no file {path}. Check the folder and the file name.")
    nifti = check_header(path, case_id)
    if nifti is not None and nifti.misleads_itk:
        found = _read_nifti(nifti)
    else:
        found = _read_by_itk(path, case_id)
    if nifti is not None:
        return found if unit is None else scaled(found, MM_OF[unit] / nifti.unit_mm)
    return scaled(found, MM_OF[unit or stated_unit(path) or "mm"])


def _read_by_itk(path: Path, case_id: str) -> LabelImage:
    image = read_image(path, case_id)
    _check_three_dimensions(image.GetSize(), image.GetNumberOfComponentsPerPixel(), path, case_id)
    labels = sitk.GetArrayFromImage(image)
    check_voxels(path, case_id, labels)
    return LabelImage(
        labels=labels,
        spacing_mm=np.array(image.GetSpacing()),
        origin_mm=np.array(image.GetOrigin()),
        direction=np.array(image.GetDirection()).reshape(3, 3),
        case_id=case_id,
    )


def _read_nifti(file: NiftiFile) -> LabelImage:
    size = [int(length) for length in file.header["dim"][1 : 1 + int(file.header["dim"][0])]]
    while len(size) > 3 and size[-1] == 1:
        size.pop()
    kind = file.header.get_data_dtype()
    _check_three_dimensions(size, len(kind.names or ("one",)), file.path, file.case_id)
    refuse_too_large(needed_gb_of(size, kind.itemsize), file.path, file.case_id)
    voxels = file.voxels().reshape(size[::-1])
    return place(voxels, file.affine_lps(), file.case_id, file.warnings())


def _check_three_dimensions(size: Sequence[int], values: int, path: Path, case_id: str) -> None:
    if len(size) != 3 or values != 1:
        raise CaseError(
            case_id,
            f"{path.name} holds a {' × '.join(map(str, size))} image with {values} value(s) per "
            "voxel; one 3D volume of labels is needed. Export it as such.",
        )


def read_image(path: Path, case_id: str) -> sitk.Image:
    """SimpleITK's image.

    Raises:
        CaseError: Where SimpleITK can't read the file.
        StudyError: Where there is not the memory for it.
    """
    try:
        refuse_too_large(needed_gb(path), path, case_id)
        return sitk.ReadImage(str(path))
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1].strip()
        raise CaseError(
            case_id,
            f"{path.name} can't be read ({reason}). Check that the file is whole and that it is "
            "a label image.",
        ) from error


def read_organ(
    path: Path,
    labels: tuple[int, ...],
    case_id: str,
    organ: str = "organ",
    allow_truncated: bool = True,
    threshold: float | None = None,
    unit: Unit | None = None,
) -> Mask:
    """Read one file and select its organ.

    Raises:
        CaseError: as `read_labels` and `select_labels` do; and, without `unit`, for a size that no
            organ has in millimetres.
    """
    image = read_labels(path, case_id, unit)
    mask = select_labels(image, labels, organ, allow_truncated, threshold)
    if unit is None:
        check_size(mask_diagonal(mask), case_id, f"the {organ} in {path.name}")
    return mask

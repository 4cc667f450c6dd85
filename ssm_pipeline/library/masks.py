"""Masks from files and arrays, and their surfaces."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ssm_pipeline.data_prep.formats.image_files import image_stem, image_suffix
from ssm_pipeline.data_prep.formats.images import read_labels
from ssm_pipeline.data_prep.formats.label_images import LabelImage
from ssm_pipeline.data_prep.formats.organ_masks import mask_diagonal, select_labels
from ssm_pipeline.data_prep.formats.organ_size import check_size
from ssm_pipeline.data_prep.formats.segments import is_segmentation, read_segments
from ssm_pipeline.meshing.mask_to_mesh import mesh_with_quality
from ssm_pipeline.meshing.settings import MeshingSettings
from ssm_pipeline.records import CaseError, Mask, Mesh, require_type


def read_mask(
    source: str | Path | np.ndarray,
    labels: int | Sequence[int] | None = None,
    *,
    threshold: float | None = None,
    segments: str | Sequence[str] = (),
    case_id: str | None = None,
    spacing_mm: npt.ArrayLike | None = None,
    origin_mm: npt.ArrayLike = (0.0, 0.0, 0.0),
    direction: npt.ArrayLike = ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
) -> Mask:
    """Read the mask of one organ from a label image, or make it from an array.

    Args:
        source: A file (.nii.gz, .nii, .nrrd, .mhd, .mha, .seg.nrrd or DICOM SEG); or an array
            `(Z, Y, X)` of labels or of bool.
        labels: The label of the organ, or several whose union is the organ. None: the only label
            of the image.
        threshold: For probability maps, in place of labels: the organ is above it.
        segments: For .seg.nrrd and DICOM SEG, in place of labels: the names of the segments.
        case_id: Names the case in messages and tables. None: the name of the file, or "array".
        spacing_mm: For an array: `(3,)` voxel size along x, y, z, mm. A file has its own.
        origin_mm: For an array: `(3,)` the centre of voxel (0, 0, 0), mm LPS.
        direction: For an array: `(3, 3)`, its columns are the axes x, y, z in LPS.

    Returns:
        The organ's voxels in patient space. `warnings` says so where it touches the image border.

    Raises:
        TypeError: For a source of another type, and for an array without its spacing.
        CaseError: For a file that is missing, damaged or of another kind, and for a label that is
            absent or not named although the image has several.

    Examples:
        >>> voxels = np.zeros((20, 20, 20), dtype=np.uint8)
        >>> voxels[5:15, 5:15, 5:15] = 3
        >>> mask = read_mask(voxels, labels=3, spacing_mm=(1, 1, 2), case_id="liver_7")
        >>> mask.volume_mm3
        2000.0
    """
    require_type(source, (str, Path, np.ndarray), "source")
    chosen = (segments,) if isinstance(segments, str) else tuple(segments)
    if isinstance(source, np.ndarray):
        if spacing_mm is None:
            raise TypeError(
                "an array does not say how large its voxels are; pass spacing_mm=(x, y, z) in mm."
            )
        image = LabelImage(
            source.astype(np.uint8) if source.dtype == bool else source,
            np.asarray(spacing_mm, dtype=np.float64),
            np.asarray(origin_mm, dtype=np.float64),
            np.asarray(direction, dtype=np.float64),
            case_id or "array",
        )
        if source.ndim != 3:
            raise CaseError(
                image.case_id, f"the array has shape {source.shape}; (Z, Y, X) is needed."
            )
    else:
        path = Path(source)
        case_id = case_id or image_stem(path)
        if spacing_mm is not None:
            raise TypeError("spacing_mm is for arrays; a file says how large its voxels are.")
        if chosen:
            return read_segments(path, chosen, case_id, threshold=threshold)
        if image_suffix(path) is None and is_segmentation(path):
            raise CaseError(case_id, f"{path.name} is a DICOM SEG. Pass segments=NAME.")
        image = read_labels(path, case_id)
    mask = select_labels(image, _chosen_labels(image, labels, threshold), threshold=threshold)
    if not isinstance(source, np.ndarray):
        check_size(mask_diagonal(mask), mask.case_id, f"the organ in {Path(source).name}")
    return mask


def mesh_from_mask(mask: Mask, settings: MeshingSettings | None = None) -> Mesh:
    """The surface of a mask, as a study makes it: closed, smooth, and with the mask's volume.

    Args:
        mask: The mask of `read_mask`. Only its largest piece is used.
        settings: The number of triangles and the smoothing. None: a study's defaults.

    Returns:
        A closed manifold with about `settings.faces` triangles, in mm LPS.

    Raises:
        TypeError: For anything but a Mask.
        CaseError: Where no closed surface results.

    Source: Cao et al. 2024, the LUNA16 experiment (marching cubes, Laplacian smoothing, quadric
    decimation to about 8000 triangles).

    Examples:
        >>> z, y, x = np.indices((30, 30, 30)) - 15
        >>> ball = read_mask(z**2 + y**2 + x**2 < 100, spacing_mm=(2, 2, 2), case_id="ball")
        >>> mesh = mesh_from_mask(ball, MeshingSettings(faces=1000))
        >>> len(mesh.faces)
        1000
    """
    require_type(mask, Mask, "mask", "Read it with read_mask, or make one from an array with Mask.")
    return mesh_with_quality(mask, settings or MeshingSettings())[0]


def _chosen_labels(
    image: LabelImage, labels: int | Sequence[int] | None, threshold: float | None
) -> tuple[int, ...]:
    if threshold is not None:
        return ()
    if labels is not None:
        given = labels if isinstance(labels, Iterable) else [labels]
        return tuple(int(label) for label in given)
    found = np.unique(image.labels)
    found = found[found != 0]
    if len(found) != 1 or found[0] != np.rint(found[0]):
        listed = ", ".join(f"{value:g}" for value in found[:20]) or "none: the mask is empty"
        raise CaseError(
            image.case_id,
            f"the image has {len(found)} labels ({listed}); which is the organ? Pass labels=, as "
            "labels=3.",
        )
    return (int(found[0]),)

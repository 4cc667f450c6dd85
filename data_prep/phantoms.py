"""Synthetic lungs in LUNA16's layout, with exact correspondences and modes.

The folder reads like a LUNA16 download (`phantom.000.mhd` + `.zraw`, label 3 left, 4 right), and
holds the truth of the left lungs in `truth.npz`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import SimpleITK as sitk
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
from vtkmodules.vtkImagingStencil import vtkImageStencilToImage, vtkPolyDataToImageStencil

from data_prep import luna16
from data_prep.phantom_lung import CENTRE, mean_lung, mode_fields
from data_prep.phantom_settings import PhantomSettings
from ssm_pipeline import storage
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records import Cohort, PhantomTruth, StudyError

GENERATOR_VERSION = 1  # raise it when the same settings give other phantoms
MAX_SCORE_NORM = 4.0  # scores beyond are drawn again; up to here no surface can meet itself
_SETTINGS_FILE, _TRUTH_FILE = "phantoms.json", "truth.npz"
_MARGIN_MM = 6.0


def make_cohort(folder: Path, settings: PhantomSettings | None = None) -> Cohort:
    """Write the phantoms to `folder` and return them with their truth.

    The same settings give the same bytes; a folder that already holds them is read, not
    written. Raises StudyError if the folder holds files of another kind.
    """
    settings = settings or PhantomSettings()
    stated = {"generator_version": GENERATOR_VERSION, "settings": settings.model_dump(mode="json")}
    marker = folder / _SETTINGS_FILE
    if marker.is_file():
        if storage.read_json(marker) == stated:
            return read_cohort(folder)
        marker.unlink()  # first, so that a half-written folder is never taken for a whole one
        for path in folder.glob("phantom.*"):
            path.unlink()
    elif folder.is_dir() and any(not p.name.startswith("phantom.") for p in folder.glob("*.mhd")):
        raise StudyError(
            f"{folder} holds masks that are not phantoms. Give an empty or a new folder."
        )
    folder.mkdir(parents=True, exist_ok=True)
    truth, right_lungs = draw(settings)
    for case_id, left, right in zip(truth.case_ids, truth.vertices, right_lungs, strict=True):
        # Mirroring turns the triangles around.
        surfaces = {luna16.LEFT: (left, truth.faces), luna16.RIGHT: (right, truth.faces[:, ::-1])}
        image = voxelise(surfaces, settings.spacing_mm)
        sitk.WriteImage(image, str(folder / f"{case_id}.mhd"), useCompression=True)
    storage.save(truth, folder / _TRUTH_FILE)
    storage.write_json(marker, stated)
    return read_cohort(folder)


def read_cohort(folder: Path) -> Cohort:
    """The left lungs of a phantom folder, with their truth. Raises StudyError without one."""
    path = folder / _TRUTH_FILE
    if not (path.is_file() and (folder / _SETTINGS_FILE).is_file()):
        raise StudyError(f"{folder} holds no finished phantom cohort. Make it with make_cohort.")
    truth = storage.load(PhantomTruth, path)
    scans = luna16.find_cases(folder, side="left", cases=truth.case_ids)
    return replace(scans, name="phantoms", truth=truth)


def draw(settings: PhantomSettings) -> tuple[PhantomTruth, np.ndarray]:
    """The truth of the left lungs and the right lungs' vertices (N, R, 3) mm, by the seed.

    The right lungs are mirror images with scores of their own; they have no truth.
    """
    generator = np.random.default_rng(settings.seed)
    mean, faces = mean_lung()
    modes = np.stack([field(mean) for field in mode_fields()[: settings.modes]])
    scores = np.stack([_draw_scores(generator, settings.modes) for _ in range(settings.cases)])
    right_scores = np.stack(
        [_draw_scores(generator, settings.modes) for _ in range(settings.cases)]
    )
    frames = tuple(_draw_frame(generator, settings) for _ in range(settings.cases))
    moved, mirrored = (
        np.stack(
            [
                frame.apply((mean + np.tensordot(s, modes, axes=1)) * side)
                for frame, s in zip(frames, sides_scores, strict=True)
            ]
        )
        for side, sides_scores in (
            (np.array([1.0, 1, 1]), scores),
            (np.array([-1.0, 1, 1]), right_scores),
        )
    )
    case_ids = tuple(f"phantom.{number:03d}" for number in range(settings.cases))
    return PhantomTruth(moved, faces, mean, modes, scores, case_ids, frames), mirrored


def voxelise(
    surfaces: dict[int, tuple[np.ndarray, np.ndarray]], spacing_mm: tuple[float, float, float]
) -> sitk.Image:
    """Label → (vertices, faces) mm LPS, as a label image: voxels whose centres lie inside."""
    points = np.concatenate([vertices for vertices, _ in surfaces.values()])
    spacing = np.array(spacing_mm)
    origin = np.floor((points.min(axis=0) - _MARGIN_MM) / spacing) * spacing
    size = np.ceil((points.max(axis=0) + _MARGIN_MM - origin) / spacing).astype(int) + 1
    labels = np.zeros(size[::-1], np.uint8)
    for label, (vertices, faces) in surfaces.items():
        labels[_inside(vertices, faces, origin, spacing, size)] = label
    image = sitk.GetImageFromArray(labels)
    image.SetSpacing(spacing.tolist())
    image.SetOrigin(origin.tolist())
    return image


def _inside(
    vertices: np.ndarray,
    faces: np.ndarray,
    origin: np.ndarray,
    spacing: np.ndarray,
    size: np.ndarray,
) -> np.ndarray:
    surface, points, cells = vtkPolyData(), vtkPoints(), vtkCellArray()
    points.SetData(numpy_to_vtk(np.ascontiguousarray(vertices)))
    cells.SetData(3, numpy_to_vtkIdTypeArray(np.ascontiguousarray(faces).ravel(), deep=True))
    surface.SetPoints(points)
    surface.SetPolys(cells)
    stencil = vtkPolyDataToImageStencil()
    stencil.SetInputData(surface)
    stencil.SetOutputOrigin(*origin)
    stencil.SetOutputSpacing(*spacing)
    stencil.SetOutputWholeExtent(0, size[0] - 1, 0, size[1] - 1, 0, size[2] - 1)
    stencil.SetTolerance(0)
    filled = vtkImageStencilToImage()
    filled.SetInputConnection(stencil.GetOutputPort())
    filled.SetInsideValue(1)
    filled.SetOutsideValue(0)
    filled.SetOutputScalarTypeToUnsignedChar()
    filled.Update()
    scalars = filled.GetOutput().GetPointData().GetScalars()
    return vtk_to_numpy(scalars).reshape(size[::-1]).astype(bool)


def _draw_scores(generator: np.random.Generator, count: int) -> np.ndarray:
    while True:
        scores = generator.standard_normal(count)
        if np.linalg.norm(scores) <= MAX_SCORE_NORM:
            return scores


def _draw_frame(generator: np.random.Generator, settings: PhantomSettings) -> Similarity:
    """A turn of the patient about the midpoint between the lungs, and a shift."""
    axis = generator.standard_normal(3)
    angle = turn_angle(generator.random(), np.radians(settings.max_rotation_deg))
    rotation = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
    shift = settings.translation_mm * generator.standard_normal(3)
    pivot = CENTRE * [0, 1, 1]
    return Similarity(1.0, rotation, pivot - rotation @ pivot + shift)


def turn_angle(share: float, largest: float) -> float:
    """The angle (radians) that `share` of all rotations of up to `largest` stay below.

    Rotations are drawn evenly from all those allowed, so large angles are the rule: of rotations
    by an angle a there are in proportion to 1 − cos a.
    """
    total = largest - np.sin(largest)
    if total == 0:
        return 0.0
    return float(brentq(lambda angle: angle - np.sin(angle) - share * total, 0, largest))

"""Smooth synthetic lungs: star-shaped, of five or six modes and nothing else, nearly affine.

Every matcher does well on them, and one that uses affine maps better than it deserves. Their folder
reads like a LUNA16 download (`phantom.000.mhd` + `.zraw`, label 3 left, 4 right); the truth is that
of the left lungs.
"""

from __future__ import annotations

import numpy as np
import SimpleITK as sitk

from ssm_pipeline.data_prep.cohorts import luna16
from ssm_pipeline.data_prep.synthetic.phantom_pose import draw_frame
from ssm_pipeline.data_prep.synthetic.phantom_scan import Grid, inside
from ssm_pipeline.data_prep.synthetic.phantom_settings import PhantomSettings
from ssm_pipeline.data_prep.synthetic.smooth_lung import CENTRE, mean_lung, mode_fields
from ssm_pipeline.records import PhantomTruth

MAX_SCORE_NORM = 4.0  # scores beyond are drawn again; up to here no surface can meet itself
MODES, SPACING_MM = 5, (1.0, 1.0, 1.5)
_MARGIN_MM = 6.0


def draw(settings: PhantomSettings) -> tuple[PhantomTruth, np.ndarray]:
    """The truth of the left lungs and the right lungs' vertices (N, R, 3) mm, by the seed.

    The right lungs are mirror images with scores of their own; they have no truth.
    """
    generator = np.random.default_rng(settings.seed)
    mean, faces = mean_lung()
    count = settings.modes or MODES
    modes = np.stack([field(mean) for field in mode_fields()[:count]])
    scores = np.stack([_draw_scores(generator, count) for _ in range(settings.cases)])
    right_scores = np.stack([_draw_scores(generator, count) for _ in range(settings.cases)])
    pivot = CENTRE * [0, 1, 1]  # the midpoint between the lungs
    frames = tuple(draw_frame(generator, settings, pivot) for _ in range(settings.cases))
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


def scan(
    left: np.ndarray, right: np.ndarray, faces: np.ndarray, settings: PhantomSettings
) -> sitk.Image:
    """A patient's lungs (R, 3) mm as a label image of LUNA16's labels."""
    # Mirroring turns the triangles around.
    surfaces = {luna16.LEFT: (left, faces), luna16.RIGHT: (right, faces[:, ::-1])}
    return voxelise(surfaces, settings.spacing_mm or SPACING_MM)


def voxelise(
    surfaces: dict[int, tuple[np.ndarray, np.ndarray]], spacing_mm: tuple[float, float, float]
) -> sitk.Image:
    """Label → (vertices, faces) mm LPS, as a label image: voxels whose centres lie inside."""
    points = np.concatenate([vertices for vertices, _ in surfaces.values()])
    spacing = np.array(spacing_mm)
    origin = np.floor((points.min(axis=0) - _MARGIN_MM) / spacing) * spacing
    size = np.ceil((points.max(axis=0) + _MARGIN_MM - origin) / spacing).astype(int) + 1
    grid = Grid(origin, spacing, size)
    labels = np.zeros(size[::-1], np.uint8)
    for label, (vertices, faces) in surfaces.items():
        labels[inside(vertices, faces, grid)] = label
    return grid.image(labels)


def _draw_scores(generator: np.random.Generator, count: int) -> np.ndarray:
    while True:
        scores = generator.standard_normal(count)
        if np.linalg.norm(scores) <= MAX_SCORE_NORM:
            return scores

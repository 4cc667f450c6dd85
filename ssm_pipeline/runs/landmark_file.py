"""The landmark file that a study names: read it, and check that it lies on the template."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ssm_pipeline.data_prep.formats.landmarks import Landmarks, read_landmarks
from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.records import StudyError
from ssm_pipeline.runs.run import Run

# Of the template's diagonal. A point placed by hand lies within a voxel or two of the surface; one
# placed on another case is mostly farther off.
FARTHEST_SHARE = 0.05


def landmarks_on_template(path: Path, run: Run, setting: str = "report.landmarks") -> Landmarks:
    """`read_landmarks`, checked against the template's surface.

    Args:
        setting: What names the file, for messages: a setting or an option.

    Raises:
        StudyError: the file can't be read, or a point is far from the template.
    """
    landmarks, template_id, shapes = read_landmarks(path, setting), run.template_id, run.shapes
    if template_id not in shapes.case_ids:
        raise StudyError(
            f"landmarks can't be transferred: the template {template_id} is not in the model. "
            f"Name another template, or leave {setting} out."
        )
    template = shapes.template
    distances = closest_points(landmarks.positions, template, shapes.faces).distances
    farthest = FARTHEST_SHARE * float(np.linalg.norm(np.ptp(template, axis=0)))
    worst = int(distances.argmax())
    if distances[worst] > farthest:
        raise StudyError(
            f"landmark {landmarks.names[worst]} of {path} lies {distances[worst]:.1f} mm from the "
            f"template, case {template_id}; {farthest:.1f} mm or less is needed. Place it on "
            "meshes/template.ply of `workflow export`, and set template to the case it was placed "
            "on."
        )
    return landmarks

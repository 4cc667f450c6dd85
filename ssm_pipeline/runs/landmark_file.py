"""The landmark file that a study names: read it, and check that it lies on the template."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ssm_pipeline import storage
from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.records import DamagedFile, StudyError
from ssm_pipeline.report.landmarks import Landmarks, landmarks_from_markups
from ssm_pipeline.runs.run import Run

# Of the template's diagonal. A point placed by hand lies within a voxel or two of the surface; one
# placed on another case is mostly farther off.
FARTHEST_SHARE = 0.05


def read_landmarks(path: Path, setting: str = "report.landmarks") -> Landmarks:
    """Landmarks of a Slicer `.mrk.json`.

    Args:
        setting: That names the file, for the message.

    Raises:
        StudyError: If it is missing or unreadable.
    """
    advice = f"Save it from 3D Slicer's Markups as .mrk.json, or leave {setting} out."
    try:
        return landmarks_from_markups(storage.read_json(path))
    except DamagedFile as error:
        raise StudyError(
            f"the landmark file {path} holds no markups: it {error.found}. {advice}"
        ) from error
    except OSError as error:
        raise StudyError(
            f"the landmark file {path} can't be read ({error.strerror}). {advice}"
        ) from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:  # JSON, but not of markups
        raise StudyError(
            f"the landmark file {path} holds no markups: {error!r}. {advice}"
        ) from error


def landmarks_on_template(path: Path, run: Run) -> Landmarks:
    """`read_landmarks`, checked against the template's surface. Raises StudyError."""
    landmarks, template_id, shapes = read_landmarks(path), run.template_id, run.shapes
    if template_id not in shapes.case_ids:
        raise StudyError(
            f"landmarks can't be carried over: the template {template_id} is not in the model. "
            "Name another template, or leave report.landmarks out."
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

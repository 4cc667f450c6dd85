"""How a phantom patient lies in the scanner."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from ssm_pipeline.data_prep.synthetic.phantom_settings import PhantomSettings
from ssm_pipeline.geometry.similarity import Similarity


def draw_frame(
    generator: np.random.Generator, settings: PhantomSettings, pivot: np.ndarray
) -> Similarity:
    """A turn of the patient about `pivot` (3,) mm, and a shift."""
    axis = generator.standard_normal(3)
    angle = turn_angle(generator.random(), np.radians(settings.max_rotation_deg))
    rotation = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
    shift = settings.translation_mm * generator.standard_normal(3)
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

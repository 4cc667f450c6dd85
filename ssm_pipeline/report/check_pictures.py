"""A small picture of a case beside a typical one, for the cohort check."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

from ssm_pipeline.geometry.surface import centroid
from ssm_pipeline.records import Mesh
from ssm_pipeline.report.rendering import Scene, render

SIZE_PX = 200  # side of the square that each is drawn in
CASE_COLOUR, TYPICAL_COLOUR = (217, 119, 87), (217, 203, 180)


def picture_beside(case: Mesh, typical: Mesh) -> bytes:
    """A PNG: the typical case on the left, the case on the right, at one scale, as they lie."""
    images = render([_scene(typical, TYPICAL_COLOUR), _scene(case, CASE_COLOUR)], SIZE_PX)
    buffer = io.BytesIO()
    Image.fromarray(np.concatenate(images, axis=1)).save(buffer, format="PNG", optimize=True)
    return buffer.getvalue()


def _scene(mesh: Mesh, colour: tuple[int, int, int]) -> Scene:
    colours = np.tile(np.array(colour, np.uint8), (len(mesh.vertices), 1))
    return Scene(mesh.vertices - centroid(mesh.vertices, mesh.faces), mesh.faces, colours=colours)

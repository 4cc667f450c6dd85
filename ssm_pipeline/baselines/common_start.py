"""The start pose of every method that needs one: the same rigid alignment for all."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from ssm_pipeline.adaptation.rigid_start import rigid_motion
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.geometry.surface import centroid, unit_area_frame
from ssm_pipeline.records import Mesh


def rigid_start(template: Mesh, case: Mesh, seed: int) -> Similarity:
    """Align a template with a case: both at unit area, centred, then rigid ICP.

    Returns:
        The frame from the template's millimetres to the case's. Its scale is the ratio of the two
        √area; the motion is found without it, so that a small organ turns as easily as a large one.
        seed: of the samples of both surfaces.

    >>> import numpy as np
    >>> corner = Mesh([[0, 0, 0], [9, 0, 0], [0, 3, 0], [0, 0, 1]],
    ...               [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], "corner")
    >>> moved = Mesh(2 * corner.vertices + 5, corner.faces, "moved")
    >>> float(rigid_start(corner, moved, seed=0).scale)
    2.0
    """
    inner, outer = (unit_area_frame(mesh.vertices, mesh.faces) for mesh in (template, case))
    found = rigid_motion(_moved(template, inner), _moved(case, outer), seed)
    scale = outer.scale / inner.scale
    translation = outer.translation + outer.scale * (
        found.translation - found.rotation @ inner.translation / inner.scale
    )
    return Similarity(scale, found.rotation, translation)


def meshes_at_common_start(
    template: Mesh, meshes: Sequence[Mesh], seed: int
) -> tuple[list[Mesh], list[Similarity]]:
    """The meshes turned and moved onto the template, sizes kept, by `rigid_start`.

    Returns:
        Them, and for each the frame from the aligned millimetres back to its own.
    """
    frames = []
    for mesh in meshes:
        start = rigid_start(template, mesh, seed)
        middle = centroid(template.vertices, template.faces)
        # Rigid: a rotation about the point of the case that the template's centre is mapped to.
        back = start.apply(middle) - start.rotation @ middle
        frames.append(Similarity(1.0, start.rotation, back))
    return [_moved(mesh, frame) for mesh, frame in zip(meshes, frames, strict=True)], frames


def _moved(mesh: Mesh, frame: Similarity) -> Mesh:
    """The mesh in the inner space of a frame."""
    return dataclasses.replace(mesh, vertices=frame.inverse().apply(mesh.vertices))

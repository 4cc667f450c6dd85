"""Where every row of a comparison starts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from shapes import blob

from ssm_pipeline.baselines.common_start import meshes_at_common_start, rigid_start
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.geometry.surface import centroid
from ssm_pipeline.records import Mesh

TURN = Rotation.from_euler("xyz", [12, -20, 15], degrees=True).as_matrix()


def test_a_moved_and_enlarged_copy_is_found() -> None:
    template = blob(1, faces=600)
    frame = Similarity(1.4, TURN, np.array([80.0, -300.0, 12.0]))
    other = blob(1, faces=500)  # the same solid, triangulated its own way
    found = rigid_start(template, Mesh(frame.apply(other.vertices), other.faces, "case"), 0)
    truth, only_moved = frame.apply(template.vertices), 1.4 * template.vertices
    off = np.linalg.norm(found.apply(template.vertices) - truth, axis=1).mean()
    # ICP creeps on a solid as round as this: what counts is that most of the turn is gone.
    turned = np.linalg.norm(only_moved - 1.4 * template.vertices @ TURN.T, axis=1).mean()
    assert off < 0.25 * turned
    assert found.scale == pytest.approx(1.4, rel=0.01)


def test_aligned_meshes_lie_on_the_template_in_their_own_size() -> None:
    template = blob(1, faces=600)
    frame = Similarity(1.4, TURN, np.array([80.0, -300.0, 12.0]))
    case = Mesh(frame.apply(template.vertices), template.faces, "case")
    (aligned,), (back,) = meshes_at_common_start(template, [case], 0)
    assert back.scale == 1
    start = rigid_start(template, case, 0)
    middle = centroid(template.vertices, template.faces)
    # As the start lays them on each other, but for the size, about the middle.
    expected = middle + 1.4 * (start.inverse().apply(case.vertices) - middle)
    assert aligned.vertices == pytest.approx(expected, abs=1e-9)
    assert back.apply(aligned.vertices) == pytest.approx(case.vertices)

from typing import Any

import numpy as np
import pytest
from shapes import basis_of, blob

from ssm_pipeline.adaptation.pose import pose_path
from ssm_pipeline.interpolation.settings import InterpolationSettings
from ssm_pipeline.matching.settings import MatchingSettings
from ssm_pipeline.training.matcher import Matcher
from ssm_pipeline.training.networks import Networks
from ssm_pipeline.training.settings import TrainingSettings


@pytest.fixture(scope="module")
def matcher() -> Any:
    settings = TrainingSettings(
        matching=MatchingSettings(features="wks", descriptors=16, channels=16, width=16, blocks=1),
        interpolation=InterpolationSettings(width=16, blocks=1),
    )
    return Matcher(Networks.new(settings, 0), settings, 0, (), 20)


def test_poses_of_a_coarse_pair_that_is_the_pair_itself_are_the_same(matcher: Any) -> None:
    template, case = basis_of(blob(1)), basis_of(blob(2))
    times = np.array([0.0, 0.5, 1.0])
    plain = pose_path(template, case, matcher, times)
    carried = pose_path(template, case, matcher, times, (template, case))
    np.testing.assert_allclose(carried, plain, atol=1e-6)  # single precision networks
    np.testing.assert_allclose(plain[0], template.vertices, atol=1e-6)
    assert np.abs(plain[2] - template.vertices).max() > 1e-3


def test_displacements_are_carried_from_a_coarser_template(matcher: Any) -> None:
    fine, coarse, case = basis_of(blob(1, faces=1500)), basis_of(blob(1, faces=300)), blob(2)
    goal = basis_of(case)
    posed = pose_path(fine, goal, matcher, np.ones(1), (coarse, goal))[0]
    expected = pose_path(coarse, goal, matcher, np.ones(1))[0] - coarse.vertices
    moved = posed - fine.vertices
    assert posed.shape == fine.vertices.shape
    # A carried displacement is a mean of the coarse ones around it: it stays within their range.
    # The map is found on the fine mesh, so what the interpolator is given differs by up to an edge.
    assert (moved.min(axis=0) >= expected.min(axis=0) - 0.03).all()
    assert (moved.max(axis=0) <= expected.max(axis=0) + 0.03).all()

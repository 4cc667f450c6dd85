from typing import Any

import numpy as np
import pytest

from ssm_pipeline.data_prep.synthetic.random_organs import random_family, varied
from ssm_pipeline.geometry.surface import volume
from ssm_pipeline.geometry.topology import face_components, is_oriented_manifold


@pytest.fixture(scope="module")
def families() -> Any:
    return [random_family(np.random.default_rng(seed), cases=2) for seed in (1, 2)]


def test_a_family_is_one_closed_surface_facing_outwards(families: Any) -> None:
    for shapes, faces in families:
        assert is_oriented_manifold(faces)
        assert face_components(faces).max() == 0
        for vertices in shapes:
            assert volume(vertices, faces) > 0
            assert 50 < np.ptp(vertices, axis=0).max() < 400  # mm


def test_cases_differ_and_families_differ_more(families: Any) -> None:
    (first, _), (second, _) = families
    assert len(first[0]) == len(first[1])
    apart = np.linalg.norm(first[0] - first[1], axis=1)
    size = np.sqrt(((first[0] - first[0].mean(axis=0)) ** 2).sum(axis=1).mean())
    assert 0.05 < np.sqrt((apart**2).mean()) / size < 0.6
    assert len(first[0]) != len(second[0])


def test_what_varies_is_the_generators(families: Any) -> None:
    mean = families[0][0][0]
    again = [varied(mean, np.random.default_rng(seed)) for seed in (5, 5, 6)]
    assert np.array_equal(again[0], again[1])
    assert not np.array_equal(again[0], again[2])

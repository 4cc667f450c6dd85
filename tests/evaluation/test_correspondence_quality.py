from typing import Any

import numpy as np
import pytest
from synthetic_shapes import sphere

from ssm_pipeline.evaluation.aligned_cohort import AlignedCohort
from ssm_pipeline.evaluation.correspondence_quality import correspondence_quality, flipped_share
from ssm_pipeline.evaluation.settings import EvaluationSettings
from ssm_pipeline.records import CorrespondedShapes, Mesh


def quality(vertices: np.ndarray, faces: np.ndarray, mesh: Mesh, reference: np.ndarray) -> Any:
    shapes = CorrespondedShapes(
        np.stack([vertices, 2 * reference - vertices]), faces, ("a", "b"), "a"
    )  # their mean is the reference
    other = Mesh(shapes.vertices[1], faces, "b")
    cohort = AlignedCohort(shapes, [mesh, other])
    table = correspondence_quality(cohort, EvaluationSettings(), np.random.default_rng(0))
    return table.iloc[0]


def test_perfect_correspondence() -> None:
    vertices, faces = sphere(3, 50)
    row = quality(vertices, faces, Mesh(vertices, faces, "a"), vertices)
    assert row["case_id"] == "a"
    assert row["surface_mm"] == pytest.approx(0, abs=1e-6)
    assert row["flipped_percent"] == 0
    assert row["uncovered_percent"] == 0
    assert row["distinct_percent"] == 100
    assert row["round_trip_mm"] == 0
    edges = vertices[faces] - vertices[np.roll(faces, 1, axis=1)]
    mean_edge = np.linalg.norm(edges, axis=2).mean()
    assert row["coverage_mm"] == pytest.approx(1.5 * mean_edge, rel=0.03)  # nearly even triangles


def test_offset_surface_is_measured_in_mm() -> None:
    vertices, faces = sphere(4, 50)
    row = quality(vertices * 1.04, faces, Mesh(vertices, faces, "a"), vertices)
    for column in ("to_case_mm", "from_case_mm", "surface_mm", "hd95_mm"):
        assert row[column] == pytest.approx(2, abs=0.05)  # the facets' sagitta


def test_half_of_the_case_left_uncovered() -> None:
    vertices, faces = sphere(4, 50)
    folded = vertices * [1, 1, np.nan]
    folded[:, 2] = np.abs(vertices[:, 2])  # the lower half is folded onto the upper
    row = quality(folded, faces, Mesh(vertices, faces, "a"), vertices)
    # Half the area, less the belt within the threshold of the equator.
    expected = 50 * (1 - row["coverage_mm"] / 50)
    assert row["uncovered_percent"] == pytest.approx(expected, abs=2)
    assert row["flipped_percent"] == pytest.approx(50, abs=3)
    assert row["distinct_percent"] < 55
    assert row["round_trip_mm"] > 10
    assert row["from_case_hd95_mm"] > 30
    assert row["to_case_mm"] == pytest.approx(0, abs=0.1)  # one direction alone sees nothing


def test_collapsed_template_is_uncovered_and_flipped() -> None:
    vertices, faces = sphere(3, 50)
    row = quality(
        np.repeat(vertices[:1], len(vertices), axis=0), faces, Mesh(vertices, faces, "a"), vertices
    )
    assert row["uncovered_percent"] > 95
    assert row["flipped_percent"] == 100
    assert row["distinct_percent"] < 1


def test_inside_out_template_is_all_flipped() -> None:
    vertices, faces = sphere(3, 50)
    assert flipped_share(vertices, faces[:, ::-1], Mesh(vertices, faces, "a")) == 1

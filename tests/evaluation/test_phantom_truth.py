import dataclasses

import numpy as np
import pytest
from synthetic_shapes import sphere

from ssm_pipeline.evaluation.phantom_truth import (
    correspondence_errors,
    recovered_modes,
    true_correspondence,
)
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records import Mesh, PhantomTruth, StudyError
from ssm_pipeline.shape_model.alignment import align
from ssm_pipeline.shape_model.pca import build


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    x, y, z = axis / np.linalg.norm(axis)
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew


def phantom(amplitudes: tuple[float, ...], count: int = 8) -> PhantomTruth:
    """Spheres of 50 mm, stretched along z (mode 1) and lobed (mode 2), each turned and moved."""
    generator = np.random.default_rng(0)
    directions, faces = sphere(4)
    fields = [
        directions * [0, 0, 1] * np.sqrt(3),
        directions * (3 * directions[:, :1] ** 2 - 1 + directions[:, 1:2] * directions[:, 2:]),
    ]
    modes = np.stack([a * f for a, f in zip(amplitudes, fields, strict=False)])
    scores = generator.standard_normal((count, len(modes)))
    mean = 50 * directions
    shapes = mean + np.tensordot(scores, modes, axes=1)
    frames = tuple(
        Similarity(1.0, rotation(generator.normal(size=3), 0.3), generator.normal(size=3) * 20)
        for _ in range(count)
    )
    vertices = np.stack([f.apply(s) for f, s in zip(frames, shapes, strict=True)])
    ids = tuple(f"phantom_{i}" for i in range(count))
    return PhantomTruth(vertices, faces, mean, modes, scores, ids, frames)


def template_of(truth: PhantomTruth, case: int = 0) -> Mesh:
    """Another triangulation of the same surface, as meshing a mask gives."""
    directions, faces = sphere(3)
    directions = directions @ rotation(np.array([1.0, 2, 3]), 0.7).T
    shape = 50 * directions
    if len(truth.modes) == 1:  # the stretch alone can be written out
        shape = shape + truth.scores[case] * truth.modes.max() * directions * [0, 0, 1]
    return Mesh(truth.frames[case].apply(shape), faces, truth.case_ids[case])


def test_truth_has_no_error():
    truth = phantom((2.0,), count=4)
    template = template_of(truth)
    table = correspondence_errors(
        true_correspondence(template, truth, truth.case_ids), template, truth
    )
    assert table["case_id"].tolist() == list(truth.case_ids[1:])
    assert table["geodesic_mm"].max() < 1e-6
    assert table["off_surface_mm"].max() < 1e-6


@pytest.mark.parametrize("angle", [0.02, 0.2, 1.0])
def test_a_known_slip_over_the_surface(angle):
    # Without deformation all cases are the sphere; matches turned about an axis of its own by α
    # are wrong by 2 r asin(sin θ sin(α/2)).
    truth = phantom((0.0,), count=3)
    template = template_of(truth)
    true = true_correspondence(template, truth, truth.case_ids)
    axis = np.array([0.0, 0, 1])
    turned, expected = [], []
    for frame, points in zip(truth.frames, true.vertices, strict=True):
        own = frame.inverse().apply(points)
        turned.append(frame.apply(own @ rotation(axis, angle).T))
        sine = np.linalg.norm(own[:, :2], axis=1) / np.linalg.norm(own, axis=1)
        expected.append((2 * 50 * np.arcsin(sine * np.sin(angle / 2))).mean())
    found = correspondence_errors(
        dataclasses.replace(true, vertices=np.stack(turned)), template, truth
    )
    # Facets instead of the sphere, and paths along the graph: below 1 %.
    assert found["geodesic_mm"].to_numpy() == pytest.approx(np.array(expected[1:]), rel=0.01)
    over_area = 100 * np.array(expected[1:]) / np.sqrt(4 * np.pi * 50**2)
    assert found["geodesic_x100"].to_numpy() == pytest.approx(over_area, rel=0.015)


def test_the_floor_recovers_the_true_modes():
    truth = phantom((2.0, 1.0))
    template = template_of(truth)
    model = build(align(true_correspondence(template, truth, truth.case_ids))[0])
    table = recovered_modes(model, model, template, truth)
    assert table["mode"].tolist() == [1, 2]
    # Alignment is not linear: modes of 2 mm on a 50 mm sphere bend by about a degree.
    assert table["angle_degrees"].max() < 3
    assert (table["angle_degrees"] == table["floor_angle_degrees"]).all()


def test_the_floor_variance_of_one_mode_by_hand():
    truth = phantom((2.0,))
    template = template_of(truth)
    model = build(align(true_correspondence(template, truth, truth.case_ids))[0])
    table = recovered_modes(model, model, template, truth)
    # |mode|² at the template's vertices: 3 a² z² each, with mean z² = 1/3 on an even sphere.
    expected = len(template.vertices) * 2.0**2 * truth.scores.var(ddof=1)
    assert table["variance_mm2"].item() == pytest.approx(expected, rel=0.01)
    assert table["angle_degrees"].item() < 0.5


def test_rigid_motion_within_the_true_modes_does_not_count():
    # A mode that also moves the whole organ: alignment takes that part away, and so must we.
    truth = phantom((2.0,))
    template = template_of(truth)
    drift = np.array([3.0, 0, 0]) + 0.02 * np.cross([0, 0, 1.0], truth.mean)
    drifting = dataclasses.replace(truth, modes=truth.modes + drift)
    model = build(align(true_correspondence(template, truth, truth.case_ids))[0])
    table = recovered_modes(model, model, template, drifting)
    assert table["angle_degrees"].item() < 0.5


def test_other_modes_are_missed():
    truth = phantom((2.0,))
    template = template_of(truth)
    true = true_correspondence(template, truth, truth.case_ids)
    floor = build(align(true)[0])
    generator = np.random.default_rng(0)
    noise = dataclasses.replace(
        true, vertices=true.vertices[:1] + generator.normal(size=true.vertices.shape)
    )
    table = recovered_modes(build(align(noise)[0]), floor, template, truth)
    assert table["angle_degrees"].item() > 80
    assert table["floor_angle_degrees"].item() < 0.5


def test_strangers_are_refused():
    truth = phantom((2.0,))
    template = template_of(truth)
    with pytest.raises(StudyError, match="not among the phantom's"):
        true_correspondence(dataclasses.replace(template, case_id="real"), truth, truth.case_ids)
    with pytest.raises(StudyError, match="other_7"):
        true_correspondence(template, truth, ("other_7",))

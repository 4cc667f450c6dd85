import dataclasses

import numpy as np
import pytest
from synthetic_shapes import sphere

from ssm_pipeline.evaluation.phantom_truth import (
    correspondence_errors,
    recovered_modes,
    true_correspondence,
    variance_kept,
)
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records import CorrespondedShapes, Mesh, PhantomTruth, StudyError
from ssm_pipeline.shape_model.alignment import align
from ssm_pipeline.shape_model.pca import pca_model


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    x, y, z = axis / np.linalg.norm(axis)
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix: np.ndarray = np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew
    return matrix


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


def written_out(truth: PhantomTruth, turn: np.ndarray | None = None) -> CorrespondedShapes:
    """`template_of`'s vertices in every case by the formula of a stretched sphere.

    turn  (3, 3): the matches slipped over the sphere. Nothing of the code under test is used.
    """
    directions, faces = sphere(3)
    directions = directions @ rotation(np.array([1.0, 2, 3]), 0.7).T
    slipped = directions if turn is None else directions @ turn.T
    stretch = truth.modes.max() * directions * [0, 0, 1]
    points = [
        frame.apply(50 * slipped + score * stretch)
        for frame, score in zip(truth.frames, truth.scores[:, 0], strict=True)
    ]
    return CorrespondedShapes(np.stack(points), faces, truth.case_ids, truth.case_ids[0])


def test_points_written_out_have_no_error() -> None:
    truth = phantom((2.0,), count=4)
    table = correspondence_errors(written_out(truth), template_of(truth), truth)
    assert table["case_id"].tolist() == list(truth.case_ids[1:])
    # Facets of 3.5 mm instead of the sphere of 50 mm: 0.03 mm below it, and less along it.
    assert table["geodesic_mm"].max() < 0.1
    assert table["off_surface_mm"].max() < 0.05
    assert (table["scored_percent"] == 100).all()


def test_true_correspondence_is_where_the_formula_says() -> None:
    truth = phantom((2.0,), count=4)
    found = true_correspondence(template_of(truth), truth, truth.case_ids)
    expected = written_out(truth).vertices
    assert np.linalg.norm(found.vertices - expected, axis=2).max() < 0.1


def test_what_is_out_of_view_is_not_scored() -> None:
    # Beyond z = 20 mm of case 2 nothing is seen, and there the matches are wrong by 30 mm.
    truth = phantom((0.0,), count=4)
    hidden = truth.mean[:, 2] > 20
    seen = np.ones((4, len(truth.mean)), bool)
    seen[2] = ~hidden
    wrong = written_out(truth)
    points = wrong.vertices.copy()
    own = truth.frames[2].inverse().apply(points[2])
    beyond = own[:, 2] > 20
    turn = rotation(np.array([0, 0, 1.0]), 1.0)
    points[2, beyond] = truth.frames[2].apply(own[beyond] @ turn.T)
    wrong = dataclasses.replace(wrong, vertices=points)
    cut = dataclasses.replace(truth, seen=seen)
    full, without = (
        correspondence_errors(wrong, template_of(truth), known).set_index("case_id")
        for known in (truth, cut)
    )
    case = truth.case_ids[2]
    assert full.loc[case, "geodesic_mm"] > 3
    assert without.loc[case, "geodesic_mm"] < 0.1
    # A cap above 20 of 50 mm is 30 % of a sphere's area.
    assert without.loc[case, "scored_percent"] == pytest.approx(70, abs=3)
    assert without.loc[truth.case_ids[1], "scored_percent"] == 100


@pytest.mark.parametrize(("flattened", "kept"), [(1.0, 1.0), (0.5, 0.25), (1.2, 1.44)])
def test_variance_kept_of_a_flattened_cohort(flattened: float, kept: float) -> None:
    # Deviations from the mean times f: variances times f².
    truth = phantom((2.0,), count=6)
    upright = truth.mean + np.tensordot(truth.scores, truth.modes, axes=1)
    truth = dataclasses.replace(truth, frames=(Similarity.identity(),) * 6, vertices=upright)
    shapes = written_out(truth)
    mean = shapes.vertices.mean(axis=0)
    flat = dataclasses.replace(shapes, vertices=mean + flattened * (shapes.vertices - mean))
    found = variance_kept(flat, template_of(truth), truth)
    assert found == pytest.approx(kept, rel=0.01)


@pytest.mark.parametrize("angle", [0.02, 0.2, 1.0])
def test_a_known_slip_over_the_surface(angle: float) -> None:
    # Without deformation all cases are the sphere; matches turned about an axis of its own by α
    # are wrong by 2 r asin(sin θ sin(α/2)).
    truth = phantom((0.0,), count=3)
    turn = rotation(np.array([0.0, 0, 1]), angle)
    directions, _ = sphere(3)
    directions = directions @ rotation(np.array([1.0, 2, 3]), 0.7).T
    sine = np.linalg.norm(directions[:, :2], axis=1)
    expected = [(2 * 50 * np.arcsin(sine * np.sin(angle / 2))).mean()] * 3
    found = correspondence_errors(written_out(truth, turn), template_of(truth), truth)
    # Facets instead of the sphere, and paths along the graph: below 1 %.
    assert found["geodesic_mm"].to_numpy() == pytest.approx(np.array(expected[1:]), rel=0.01)
    over_area = 100 * np.array(expected[1:]) / np.sqrt(4 * np.pi * 50**2)
    assert found["geodesic_x100"].to_numpy() == pytest.approx(over_area, rel=0.015)


def test_the_floor_and_the_model_are_told_apart() -> None:
    # The model has the true modes, the floor is given others: only the floor's angles are wide.
    truth = phantom((2.0,))
    template = template_of(truth)
    model = pca_model(align(written_out(truth))[0])
    generator = np.random.default_rng(0)
    shapes = written_out(truth)
    shaken = shapes.vertices[:1] + generator.normal(size=shapes.vertices.shape)
    other = pca_model(align(dataclasses.replace(shapes, vertices=shaken))[0])
    table = recovered_modes(model, other, template, truth)
    assert table["angle_degrees"].item() < 0.5
    assert table["floor_angle_degrees"].item() > 80
    assert table["variance_mm2"].item() == pytest.approx(model.variances[0])
    assert table["floor_variance_mm2"].item() == pytest.approx(other.variances[0])


def test_the_floor_recovers_the_true_modes() -> None:
    truth = phantom((2.0, 1.0))
    template = template_of(truth)
    floor = pca_model(align(true_correspondence(template, truth, truth.case_ids))[0])
    generator = np.random.default_rng(0)
    noise = generator.normal(size=(len(truth.case_ids), *template.vertices.shape))
    noisy = true_correspondence(template, truth, truth.case_ids)
    noisy = dataclasses.replace(noisy, vertices=noisy.vertices + noise)
    table = recovered_modes(pca_model(align(noisy)[0]), floor, template, truth)
    assert table["mode"].tolist() == [1, 2]
    # Alignment is not linear: modes of 2 mm on a 50 mm sphere bend by about a degree.
    assert table["floor_angle_degrees"].max() < 3
    assert (table["angle_degrees"] > table["floor_angle_degrees"] + 1).all()


def test_the_floor_variance_of_one_mode_by_hand() -> None:
    truth = phantom((2.0,))
    template = template_of(truth)
    model = pca_model(align(written_out(truth))[0])
    floor = pca_model(align(true_correspondence(template, truth, truth.case_ids))[0])
    table = recovered_modes(model, floor, template, truth)
    # |mode|² at the template's vertices: 3 a² z² each, with mean z² = 1/3 on an even sphere.
    expected = len(template.vertices) * 2.0**2 * truth.scores.var(ddof=1)
    for column in ("variance_mm2", "floor_variance_mm2"):
        assert table[column].item() == pytest.approx(expected, rel=0.01)
    for column in ("angle_degrees", "floor_angle_degrees"):
        assert table[column].item() < 0.5


def test_rigid_motion_within_the_true_modes_does_not_count() -> None:
    # A mode that also moves the whole organ: alignment takes that part away, and so must we.
    truth = phantom((2.0,))
    template = template_of(truth)
    drift = np.array([3.0, 0, 0]) + 0.02 * np.cross([0, 0, 1.0], truth.mean)
    drifting = dataclasses.replace(truth, modes=truth.modes + drift)
    model = pca_model(align(written_out(truth))[0])
    floor = pca_model(align(true_correspondence(template, truth, truth.case_ids))[0])
    table = recovered_modes(model, floor, template, drifting)
    assert table["angle_degrees"].item() < 0.5


def test_other_modes_are_missed() -> None:
    truth = phantom((2.0,))
    template = template_of(truth)
    true = true_correspondence(template, truth, truth.case_ids)
    floor = pca_model(align(true)[0])
    generator = np.random.default_rng(0)
    noise = dataclasses.replace(
        true, vertices=true.vertices[:1] + generator.normal(size=true.vertices.shape)
    )
    table = recovered_modes(pca_model(align(noise)[0]), floor, template, truth)
    assert table["angle_degrees"].item() > 80
    assert table["floor_angle_degrees"].item() < 0.5


def test_strangers_are_refused() -> None:
    truth = phantom((2.0,))
    template = template_of(truth)
    with pytest.raises(StudyError, match="not among the phantom's"):
        true_correspondence(dataclasses.replace(template, case_id="real"), truth, truth.case_ids)
    with pytest.raises(StudyError, match="other_7"):
        true_correspondence(template, truth, ("other_7",))

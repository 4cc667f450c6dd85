from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from shapes import basis_of, blob

from ssm_pipeline.adaptation.correspond import correspond_again
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records import CorrespondedShapes, Correspondence, Mesh
from ssm_pipeline.shape_model.collected_points import collect, points_on_cases
from ssm_pipeline.shape_model.groupwise_rounds import groupwise_rounds, placed_means
from ssm_pipeline.shape_model.settings import GroupwiseSettings


def moved(generator: np.random.Generator) -> Similarity:
    rotation = Rotation.from_rotvec(0.5 * generator.standard_normal(3)).as_matrix()
    return Similarity(1.0, rotation, 20 * generator.standard_normal(3))


@pytest.fixture(scope="module")
def cohort() -> CorrespondedShapes:
    """One shape, moved rigidly three times, and once that shape with its upper half bent over."""
    generator = np.random.default_rng(0)
    mesh = blob(1, faces=300)
    bent = mesh.vertices + [[0.2, 0.0, 0.0]] * np.maximum(mesh.vertices[:, 2:], 0)
    points = [moved(generator).apply(s) for s in [mesh.vertices] * 3 + [bent]]
    return CorrespondedShapes(np.stack(points), mesh.faces, tuple("abcd"), "b")


def test_the_mean_of_equal_shapes_lies_on_each(cohort: CorrespondedShapes) -> None:
    means = placed_means(cohort, mean_of="abc")
    for case_id, points in zip("abc", cohort.vertices[:3], strict=True):
        np.testing.assert_allclose(means[case_id], points, atol=1e-6)


def test_a_case_outside_the_mean_is_laid_on_and_not_mixed_in(cohort: CorrespondedShapes) -> None:
    bent = cohort.vertices[3]
    away = {
        name: np.linalg.norm(placed_means(cohort, mean_of=of)["d"] - bent, axis=1).mean()
        for name, of in (("without", "abc"), ("with", None))
    }
    assert away["without"] < 2.5  # the straight mean, sheared towards it
    assert 0.6 * away["without"] < away["with"] < 0.9 * away["without"]  # it is a quarter of it


def test_a_larger_and_flatter_case_is_reached_by_the_affine_mean_alone() -> None:
    mesh = blob(1, faces=300)
    flat = moved(np.random.default_rng(1)).apply(mesh.vertices * [1.3, 1.2, 0.8])
    shapes = CorrespondedShapes(
        np.stack([mesh.vertices, mesh.vertices, flat]), mesh.faces, tuple("abc"), "a"
    )
    np.testing.assert_allclose(placed_means(shapes, "ab", "affine")["c"], flat, atol=1e-6)


def test_a_round_takes_out_what_slid_along_the_surface() -> None:
    """Shapes that are stretched copies, each slid at random: the mean slides less, and so do the
    shapes adapted from it."""
    generator = np.random.default_rng(3)
    mesh = blob(2, faces=1500)
    stretches = 1 + 0.04 * generator.standard_normal((6, 3))
    meshes = [Mesh(mesh.vertices * s, mesh.faces, f"c{i}") for i, s in enumerate(stretches)]
    true = np.stack([m.vertices for m in meshes])
    slid = np.stack([_slid(m, generator) for m in meshes])
    shapes = CorrespondedShapes(slid, mesh.faces, tuple(m.case_id for m in meshes), "c0")
    bases = [basis_of(m) for m in meshes]
    settings = AdaptationSettings(samples=4000)
    matches = [
        correspond_again(start, bases[0], basis, settings)
        for start, basis in zip(placed_means(shapes).values(), bases, strict=True)
    ]
    after = points_on_cases(matches, meshes, mesh.faces)
    assert after.template_id == "c0"
    # One slide common to all is no error of the model: compare the displacements case to case.
    error = [
        np.linalg.norm((p - p[0]) - (true - true[0]), axis=-1)[1:].mean()
        for p in (slid, after.vertices)
    ]
    assert error[1] < 0.6 * error[0]


def test_a_round_of_one_case_leaves_the_others_as_they_are(cohort: CorrespondedShapes) -> None:
    """A new patient among the cohort: its start is the cohort's mean, and it alone is matched."""
    seen = []

    def to_first_corner(number: Any, starts: Any) -> Any:
        seen.append((number, starts["d"]))
        count = len(cohort.vertices[0])
        corner = np.tile([1.0, 0, 0], (count, 1))
        faces = np.full(count, number)  # all points to one place: it must be the mesh's own
        return [Correspondence("b", "d", faces, corner, faces, starts["d"])]

    mesh = Mesh(cohort.vertices[3], cohort.faces, "d")
    rounds = GroupwiseSettings(rounds=2)
    after = groupwise_rounds(cohort, [mesh], rounds, to_first_corner, mean_of="abc")
    np.testing.assert_array_equal(after.vertices[:3], cohort.vertices[:3])
    np.testing.assert_array_equal(
        after.vertices[3], np.broadcast_to(mesh.vertices[mesh.faces[2, 0]], mesh.vertices.shape)
    )
    assert [number for number, _ in seen] == [1, 2]
    np.testing.assert_array_equal(seen[0][1], placed_means(cohort, "abc")["d"])
    assert (after.case_ids, after.template_id) == (cohort.case_ids, "b")


def test_the_template_keeps_its_vertices_in_pairwise_matches_only() -> None:
    mesh = blob(1, faces=300)
    count = len(mesh.vertices)
    off = Correspondence(
        mesh.case_id,
        mesh.case_id,
        np.zeros(count, int),
        np.full((count, 3), 1 / 3),
        np.zeros(count, int),
        mesh.vertices,
    )
    assert (collect(mesh, [off], [mesh]).vertices[0] == mesh.vertices).all()
    centre = mesh.vertices[mesh.faces[0]].mean(axis=0)
    np.testing.assert_allclose(
        points_on_cases([off], [mesh], mesh.faces).vertices[0], np.tile(centre, (count, 1))
    )


def _slid(mesh: Mesh, generator: np.random.Generator) -> np.ndarray:
    """Its vertices, moved a few millimetres along the surface by a smooth random field."""
    from ssm_pipeline.geometry.closest_point import closest_points

    wave = np.sin(mesh.vertices @ (0.05 * generator.standard_normal((3, 3))))
    moved = mesh.vertices + 4.0 * wave @ generator.standard_normal((3, 3)) / np.sqrt(3)
    return closest_points(moved, mesh.vertices, mesh.faces).points

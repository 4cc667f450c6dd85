"""The articulated figures: sound surfaces, exact truth, families that differ as they should."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from ssm_pipeline.data_prep.synthetic.articulated import (
    Figure,
    articulated_figure,
    template_vertices,
    touches_itself,
)
from ssm_pipeline.data_prep.synthetic.articulated_body import BONES, rest_body
from ssm_pipeline.data_prep.synthetic.articulated_pose import draw_pose, draw_stance
from ssm_pipeline.data_prep.synthetic.articulated_settings import (
    DEVELOPMENT_SEED,
    REPORTED_SEED,
    ArticulatedSettings,
)
from ssm_pipeline.data_prep.synthetic.articulated_skin import Build, person, posed, skin_weights
from ssm_pipeline.geometry.surface import area, face_normals, volume
from ssm_pipeline.geometry.topology import (
    boundary_edges,
    directed_edges,
    euler_number,
    face_components,
    is_oriented_manifold,
    min_angle_deg,
)

NEAR = ArticulatedSettings(training_shapes=3, test_shapes=2, persons=2)
FAR = NEAR.model_copy(update={"family": "non-isometric"})


@functools.cache
def figure(settings: ArticulatedSettings, index: int) -> Figure:
    return articulated_figure(settings, index)


def mean_edge(vertices: np.ndarray, faces: np.ndarray) -> float:
    return float(edge_lengths(vertices, faces).mean())


def edge_lengths(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    edges = directed_edges(faces)
    return np.asarray(np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1))


def folded_edges(vertices: np.ndarray, faces: np.ndarray) -> int:
    """Edges at which the surface turns by more than 120 degrees."""
    normals = face_normals(vertices, faces)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    order = np.lexsort(np.sort(directed_edges(faces), axis=1).T) % len(faces)
    cosines = (normals[order[::2]] * normals[order[1::2]]).sum(axis=1)
    return int((cosines < -0.5).sum())


def test_the_reference_body_is_closed_symmetric_and_of_human_size() -> None:
    vertices, faces = rest_body()
    assert 14_000 < len(vertices) < 21_000
    assert is_oriented_manifold(faces)
    assert euler_number(faces) == 2
    assert 1600 < np.ptp(vertices[:, 2]) < 1850  # mm tall
    assert 4e7 < volume(vertices, faces) < 9e7  # 40 to 90 litres
    # Left and right are mirror images, up to the triangulation; front and back are not.
    tree = cKDTree(vertices)
    mirrored = tree.query(vertices * [-1, 1, 1])[0]
    assert mirrored.max() < 11
    assert tree.query(vertices * [1, -1, 1])[0].max() > 60  # the feet


@pytest.mark.parametrize("settings", [NEAR, FAR], ids=lambda settings: settings.family)
def test_every_figure_is_one_closed_surface_that_keeps_its_volume(
    settings: ArticulatedSettings,
) -> None:
    for index in range(3):
        made = figure(settings, index)
        vertices, faces = made.mesh.vertices, made.mesh.faces
        assert is_oriented_manifold(faces)
        assert euler_number(faces) == 2
        assert not len(boundary_edges(faces))
        assert face_components(faces).max() == 0
        assert 0.85 * 5000 < len(vertices) < 1.15 * 5000
        assert min_angle_deg(vertices, faces) > 5
        assert folded_edges(vertices, faces) <= 2  # of 15 000
        # Chords of thin limbs cut a few per cent off.
        true_volume = volume(made.surface, rest_body()[1])
        assert 0.94 < volume(vertices, faces) / true_volume < 1


def test_bent_and_twisted_limbs_keep_their_volume_without_folds() -> None:
    even = np.ones(len(BONES))
    at_rest = person(Build(even, even))
    vertices, faces = rest_body()
    assert at_rest.vertices == pytest.approx(vertices)
    generator = np.random.default_rng(DEVELOPMENT_SEED)
    kept = 0
    while kept < 6:
        surface = posed(at_rest, draw_pose(draw_stance(generator), generator))
        if touches_itself(surface):
            continue
        kept += 1
        assert 0.95 < volume(surface, faces) / volume(vertices, faces) < 1.09
        assert folded_edges(surface, faces) <= 5  # of 50 000


def test_weights_are_smooth_shares() -> None:
    weights = skin_weights()
    assert weights.min() >= -1e-12
    assert weights.sum(axis=1) == pytest.approx(1)
    edges = directed_edges(rest_body()[1])
    # A step from one bone to the next takes several edges: at the wrist, of 25 mm, two or three.
    assert np.abs(weights[edges[:, 0]] - weights[edges[:, 1]]).max() < 0.45


@pytest.mark.parametrize("settings", [NEAR, FAR], ids=lambda settings: settings.family)
def test_the_truth_is_the_nearest_vertex_of_the_same_part(settings: ArticulatedSettings) -> None:
    for index in range(2):
        made = figure(settings, index)
        off = made.mesh.vertices[made.template_to_shape] - made.points
        edge = mean_edge(made.mesh.vertices, made.mesh.faces)
        distances = np.linalg.norm(off, axis=1)
        assert distances.mean() < 0.5 * edge
        # A triangle's centre lies 0.58 edges from its corners; tips of thumbs are worn off.
        assert np.quantile(distances, 0.999) < 0.8 * edge
        assert distances.max() < 1.6 * edge
        # The vertex lies beside the point on the posed reference body, not across a gap.
        nearest = cKDTree(made.surface).query(made.mesh.vertices[made.template_to_shape])[1]
        rest = rest_body()[0]
        points_at_rest = rest[template_vertices(settings.template_vertices)]
        assert np.linalg.norm(rest[nearest] - points_at_rest, axis=1).max() < 3 * edge


def test_one_family_keeps_lengths_and_the_other_does_not() -> None:
    """Edges and geodesics of the posed reference body, from one figure to another."""
    faces = rest_body()[1]
    edges = directed_edges(faces)
    sources = template_vertices(5000)[::900]

    def change(settings: ArticulatedSettings, pairs: list[tuple[int, int]]) -> tuple[float, float]:
        """Median relative change of edges, and of paths along edges, apart from size."""
        changes = []
        for pair in pairs:
            lengths = [edge_lengths(figure(settings, index).surface, faces) for index in pair]
            size = 2 * [len(rest_body()[0])]
            graphs = [coo_array((row, edges.T), size).tocsr() for row in lengths]
            paths = [dijkstra(graph, indices=sources) for graph in graphs]
            for one, other in (lengths, paths):
                known = one > 0
                ratios = np.log(one[known] / other[known])
                changes.append(np.median(np.abs(ratios - np.median(ratios))))
        return float(np.mean(changes[::2])), float(np.mean(changes[1::2]))

    one_person = change(NEAR, [(0, 2)])
    persons = change(NEAR, [(0, 1), (1, 2)])
    shapes = change(FAR, [(0, 1), (0, 2), (1, 2)])
    # Of one person only the joints stretch.
    assert max(one_person) < 0.03
    assert max(persons) < 0.08
    assert shapes[0] > 0.12 > 2 * persons[0]
    assert shapes[1] > 0.08


def test_no_two_triangulations_are_alike() -> None:
    """Carried to rest, one figure's vertices lie anywhere between another's."""

    def at_rest(made: Figure) -> np.ndarray:
        nearest = cKDTree(made.surface).query(made.mesh.vertices)[1]
        return np.asarray(rest_body()[0][nearest])

    first, second = figure(NEAR, 0), figure(NEAR, 2)
    assert len(first.mesh.vertices) != len(second.mesh.vertices)
    apart = cKDTree(at_rest(first)).query(at_rest(second))[0]
    # Points strewn over a triangulation are 0.36 edges from its vertices on average; reading them
    # off the reference body's vertices, 11 mm apart, moves them by a few millimetres more.
    assert apart.mean() > 0.3 * mean_edge(first.mesh.vertices, first.mesh.faces)


def test_the_seed_decides_everything() -> None:
    again = articulated_figure(NEAR, 0)
    assert (again.mesh.vertices == figure(NEAR, 0).mesh.vertices).all()
    assert (again.mesh.faces == figure(NEAR, 0).mesh.faces).all()
    assert (again.template_to_shape == figure(NEAR, 0).template_to_shape).all()
    other = articulated_figure(NEAR.model_copy(update={"seed": DEVELOPMENT_SEED}), 0)
    assert not np.allclose(other.points, again.points)
    assert DEVELOPMENT_SEED != REPORTED_SEED == ArticulatedSettings().seed


def test_training_shapes_come_first_and_a_new_person_is_tested() -> None:
    figures = [figure(NEAR, index) for index in range(NEAR.training_shapes + NEAR.test_shapes)]
    assert len(figures) == 5
    assert len({len(one.template_to_shape) for one in figures}) == 1
    persons = [one.mesh.case_id.split("-")[1] for one in figures]
    trained = {persons[index] for index in NEAR.training_range}
    tested = [persons[index] for index in NEAR.test_range]
    assert tested[0] in trained
    assert tested[1] not in trained
    largest = max(area(one.mesh.vertices, one.mesh.faces) for one in figures)
    assert largest < 2.5e6  # mm²

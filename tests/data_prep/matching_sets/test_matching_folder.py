"""Benchmarks in the literature's layout, read, written and made from phantoms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from ssm_pipeline.data_prep.matching_sets.matching_folder import (
    read_matching_folder,
    read_off,
    write_matching_folder,
)
from ssm_pipeline.data_prep.matching_sets.matching_set import Between, MatchingSet
from ssm_pipeline.data_prep.matching_sets.remeshed_phantoms import remeshed_phantoms
from ssm_pipeline.data_prep.matching_sets.shape_choice import chosen_shapes
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.geometry.surface import volume
from ssm_pipeline.records import CaseError, Mesh, PhantomTruth, StudyError

TETRAHEDRON = "OFF\n4 4 6\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"


def write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def read_set(folder: Path) -> MatchingSet:
    """A folder of shapes that all correspond to one template."""
    shapes = read_matching_folder(folder)
    assert isinstance(shapes, MatchingSet)
    return shapes


def test_off_and_corres_folders_count_from_one_and_sort_naturally(tmp_path: Path) -> None:
    for name, numbers in (("cat10", "1\n1\n4\n"), ("cat2", "4\n3\n2\n")):
        write(tmp_path / "off" / f"{name}.off", TETRAHEDRON)
        write(tmp_path / "corres" / f"{name}.vts", numbers)
    shapes = read_set(tmp_path)
    assert [mesh.case_id for mesh in shapes.meshes] == ["cat2", "cat10"]
    assert shapes.template_to_shape[0].tolist() == [3, 2, 1]
    assert shapes.template_to_shape[1].tolist() == [0, 0, 3]
    assert shapes.meshes[0].vertices[3].tolist() == [0, 0, 1]
    assert shapes.meshes[0].faces[0].tolist() == [0, 2, 1]
    (pair, other) = shapes.known_pairs([0, 1])
    assert (pair.x, pair.y, other.x, other.y) == (0, 1, 1, 0)
    assert (pair.on_x.tolist(), pair.on_y.tolist()) == ([3, 2, 1], [0, 0, 3])
    assert [(pair.x, pair.y) for pair in shapes.known_pairs([1], with_self_pairs=True)] == [(1, 1)]


def test_files_beside_each_other_and_in_category_folders(tmp_path: Path) -> None:
    write(tmp_path / "flat" / "a.off", TETRAHEDRON)
    write(tmp_path / "flat" / "a.vts", "2\n")
    assert read_set(tmp_path / "flat").template_to_shape[0].tolist() == [1]
    write(tmp_path / "deep" / "off" / "mouse" / "run1.off", TETRAHEDRON)
    write(tmp_path / "deep" / "corres" / "mouse" / "run1.vts", "3 1\n")
    deep = read_set(tmp_path / "deep")
    assert deep.meshes[0].case_id == "mouse/run1"
    assert deep.template_to_shape[0].tolist() == [2, 0]


def test_shrec19_has_a_map_a_pair(tmp_path: Path) -> None:
    """corres/1_12.map: line k names the vertex of 12.off that corresponds to vertex k of 1.off."""
    for name in ("1", "2", "12"):
        write(tmp_path / "off" / f"{name}.off", TETRAHEDRON)
    write(tmp_path / "corres" / "1_12.map", "2\n1\n4\n4\n")
    write(tmp_path / "corres" / "12_2.map", "1\n1\n1\n1\n")
    shapes = read_matching_folder(tmp_path)
    first, second = shapes.known_pairs(range(3))
    assert [shapes.meshes[shape].case_id for shape in (first.x, first.y)] == ["1", "12"]
    assert (first.on_x.tolist(), first.on_y.tolist()) == ([0, 1, 2, 3], [1, 0, 3, 3])
    assert (second.x, second.y) == (2, 1)
    # Pairs with a shape that is left out go with it; a shape's own map is the identity.
    assert [(pair.x, pair.y) for pair in shapes.known_pairs([0, 2], True)] == [
        (0, 2),
        (0, 0),
        (2, 2),
    ]
    write(tmp_path / "corres" / "1_12.map", "2\n1\n")
    with pytest.raises(CaseError, match=r"case 1: .* has 2 lines for 4 vertices"):
        read_matching_folder(tmp_path)
    (tmp_path / "corres" / "1_12.map").rename(tmp_path / "corres" / "1_40.map")
    with pytest.raises(StudyError, match="there are no shapes 1 and 40"):
        read_matching_folder(tmp_path)


def test_topkids_all_lead_to_the_first_shape(tmp_path: Path) -> None:
    """kid00 has no file; line k of kid01_ref.vts names the vertex of kid00 for k of kid01."""
    for name in ("kid00", "kid01", "kid02"):
        write(tmp_path / "off" / f"{name}.off", TETRAHEDRON)
    write(tmp_path / "corres" / "kid01_ref.vts", "4\n3\n2\n1\n")
    write(tmp_path / "corres" / "kid02_ref.vts", "1\n1\n2\n2\n")
    first, second = read_matching_folder(tmp_path).known_pairs(range(3))
    assert (first.x, first.y, second.x, second.y) == (0, 1, 0, 2)
    assert (first.on_x.tolist(), first.on_y.tolist()) == ([3, 2, 1, 0], [0, 1, 2, 3])
    (tmp_path / "corres" / "kid02_ref.vts").unlink()
    with pytest.raises(CaseError, match="case kid02: no correspondences"):
        read_matching_folder(tmp_path)


def test_dt4d_joins_the_templates_of_two_categories(tmp_path: Path) -> None:
    """cross_category_corres/cat_fox.vts: for each template vertex of cat, that of fox."""
    for name, numbers in (("cat/a", "1 2 3"), ("cat/b", "3 2 1"), ("fox/a", "4 1")):
        write(tmp_path / "off" / f"{name}.off", TETRAHEDRON)
        write(tmp_path / "corres" / f"{name}.vts", numbers)
    bridge = tmp_path / "corres" / "cross_category_corres" / "cat_fox.vts"
    write(bridge, "2\n1\n2\n")
    write(bridge.with_name("cat_bear.vts"), "1\n")  # of a category that isn't here

    def pairs(between: Between) -> list[tuple[int, int]]:
        known = read_matching_folder(tmp_path, between).known_pairs(range(3))
        return [(pair.x, pair.y) for pair in known]

    assert pairs("within categories") == [(0, 1), (1, 0)]
    assert pairs("between categories") == [(0, 2), (1, 2)]  # as given: from cat to fox alone
    assert len(pairs("all")) == 4
    first = read_matching_folder(tmp_path, "between categories").known_pairs(range(3))[0]
    assert (first.on_x.tolist(), first.on_y.tolist()) == ([0, 1, 2], [0, 3, 0])
    write(bridge, "3\n1\n2\n")
    with pytest.raises(StudyError, match=r"3, each with a number from 1 to 2, are needed"):
        read_matching_folder(tmp_path)


def test_shapes_are_chosen_by_number_by_list_and_by_species(tmp_path: Path) -> None:
    names = ("dog_1", "dog_2", "fox_1", "hippo_5")
    meshes = [Mesh(np.zeros((1, 3)), np.zeros((0, 3), int), name) for name in names]
    write(tmp_path / "test_cat.txt", "hippo_5\ndog_2.off\n")
    for text, expected in (
        ("", [0, 1, 2, 3]),
        ("1:3", [1, 2]),
        ("fox,dog", [0, 1, 2]),
        ("test_cat.txt", [3, 1]),
    ):
        assert chosen_shapes("--test", text, meshes, tmp_path) == expected
    assert chosen_shapes("--test", "", meshes, tmp_path, leave_out=["dog_2"]) == [0, 2, 3]
    for text, message in (
        ("1:5", "asked of 4 shapes in .*; give a range within 0:4"),
        ("3:3", "--test 3:3: a range such as 80:100 is needed"),
        ("train.txt", r"there is no .*train.txt. Give a range"),
        ("wolf", "no shape's name begins with wolf; the first is dog_1"),
    ):
        with pytest.raises(StudyError, match=message):
            chosen_shapes("--test", text, meshes, tmp_path)
    write(tmp_path / "test_cat.txt", "hippo_6\n")
    with pytest.raises(StudyError, match="names hippo_6, which is no shape"):
        chosen_shapes("--test", "test_cat.txt", meshes, tmp_path)


def test_off_in_other_hands(tmp_path: Path) -> None:
    # Counts on the keyword's line, comments, blank lines, colours after coordinates and faces.
    text = (
        "OFF 3 1 0 # made elsewhere\n\n0 0 0 255 0 0\n1 0 0 0 0 0\n0 1 0 9 9 9\n3 0 1 2 0.5 0 1\n"
    )
    write(tmp_path / "x.off", text)
    mesh = read_off(tmp_path / "x.off", "x")
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    assert mesh.faces.tolist() == [[0, 1, 2]]


@pytest.mark.parametrize(
    ("off", "vts", "message"),
    [
        (TETRAHEDRON, None, "case s: no correspondences: neither"),
        (TETRAHEDRON, "0\n1\n", r"case s: .* names vertices 0 to 1; 1 to 4 are needed"),
        (TETRAHEDRON, "1\n5\n", r"case s: .* names vertices 1 to 5; 1 to 4 are needed"),
        (TETRAHEDRON, "", r"case s: .* names vertices none"),
        (TETRAHEDRON, "1\nx\n", "case s: .* more than vertex numbers"),
        ("solid cube", "1\n", "case s: .* doesn't begin with OFF"),
        (TETRAHEDRON[:40], "1\n", "case s: .* announces 4 vertices and 4 faces"),
        (TETRAHEDRON.replace("3 0 2 1", "4 0 2 1 3"), "1\n", "case s: .* aren't triangles"),
        (TETRAHEDRON.replace("1 0 0", "1 0 nought"), "1\n", "case s: .* isn't numbers"),
    ],
)
def test_a_bad_shape_is_named(tmp_path: Path, off: str, vts: str | None, message: str) -> None:
    write(tmp_path / "off" / "s.off", off)
    if vts is not None:
        write(tmp_path / "corres" / "s.vts", vts)
    with pytest.raises(CaseError, match=message):
        read_matching_folder(tmp_path)


def test_a_folder_without_shapes_says_so(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=r"no \.off file found"):
        read_matching_folder(tmp_path)


def test_what_is_written_is_read_back_by_others_and_by_us(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(1)
    mesh = Mesh(ball.vertices / 3, ball.faces, "ball")
    landmarks = np.array([5, 0, 41])
    write_matching_folder(tmp_path, [mesh], [landmarks])
    other = trimesh.load_mesh(tmp_path / "off" / "ball.off", process=False)
    assert np.asarray(other.vertices) == pytest.approx(mesh.vertices, abs=1e-8)
    assert np.array_equal(other.faces, mesh.faces)
    assert (tmp_path / "corres" / "ball.vts").read_text() == "6\n1\n42\n"
    again = read_set(tmp_path)
    assert np.array_equal(again.meshes[0].vertices, mesh.vertices)  # to the last bit
    assert np.array_equal(again.template_to_shape[0], landmarks)


def ellipsoids() -> PhantomTruth:
    ball = trimesh.creation.icosphere(4)  # 2562 points
    axes = np.array([[30.0, 20, 50], [34.0, 22, 45]])
    vertices = ball.vertices * axes[:, None]
    return PhantomTruth(
        vertices, ball.faces, vertices.mean(axis=0), np.zeros((1, *ball.vertices.shape)),
        np.zeros((2, 1)), ("a", "b"), (Similarity.identity(),) * 2,
    )  # fmt: skip


def test_remeshed_phantoms_are_the_same_surfaces_with_other_triangles() -> None:
    truth = ellipsoids()
    shapes = remeshed_phantoms(truth, [700, 1000])
    for points, mesh, vertices, count in zip(
        truth.vertices, shapes.meshes, shapes.template_to_shape, [700, 1000], strict=True
    ):
        assert len(mesh.vertices) == pytest.approx(count, rel=0.15)
        assert len(mesh.vertices) - len(mesh.faces) / 2 == 2  # closed, genus 0
        # A coarser inscribed surface loses a little volume: about edge²/8 · curvature · area.
        assert volume(mesh.vertices, mesh.faces) == pytest.approx(
            volume(points, truth.faces), rel=0.02
        )
        edges = mesh.vertices[mesh.faces[:, 0]] - mesh.vertices[mesh.faces[:, 1]]
        distance = np.linalg.norm(points - mesh.vertices[vertices], axis=1)
        # The farthest that a point of an equilateral triangle lies from its corners is edge/√3.
        assert distance.mean() < np.linalg.norm(edges, axis=1).mean() / np.sqrt(3)
    with pytest.raises(StudyError, match="3 vertex counts given for 2 phantoms"):
        remeshed_phantoms(truth, [1, 2, 3])

"""What the records promise wherever they are used."""

from __future__ import annotations

import ast
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shapes import basis_of, blob, sphere
from source_files import all_modules

from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records import (
    CaseError,
    CorrespondedShapes,
    Correspondence,
    Mask,
    Mesh,
    ShapePath,
)

ROOT = Path(__file__).parents[1]
MODULES = all_modules()


def records_of_arrays(source: str) -> dict[str, bool]:
    """Name of each dataclass that holds arrays, tensors or tables → whether it gives up `==`."""
    found = {}
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.ClassDef):
            continue
        calls = [call for call in node.decorator_list if isinstance(call, ast.Call)]
        dataclasses = [c for c in calls if getattr(c.func, "id", "") == "dataclass"]
        annotations = [ast.unparse(n.annotation) for n in node.body if isinstance(n, ast.AnnAssign)]
        array = any(w in a for a in annotations for w in ("ndarray", "Tensor", "DataFrame", "sp."))
        if dataclasses and array:
            words = {k.arg: ast.unparse(k.value) for k in dataclasses[0].keywords}
            found[node.name] = words.get("eq") == "False"
    return found


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_records_of_arrays_do_not_pretend_to_be_comparable(path: Path) -> None:
    records = records_of_arrays(path.read_text(encoding="utf-8"))
    assert all(records.values()), f"eq=False is missing: {records}"


def test_the_check_sees_a_record_that_would_compare_arrays() -> None:
    source = "@dataclass(frozen=True)\nclass Pair:\n    x: np.ndarray\n    n: int\n"
    assert records_of_arrays(source) == {"Pair": False}


def small_records() -> list[object]:
    mesh = sphere(10.0, subdivisions=1)
    points, weights = mesh.vertices[:4], np.full((4, 3), 1 / 3)
    return [
        mesh,
        basis_of(sphere(10.0, subdivisions=2), 4),
        Mask(np.ones((2, 2, 2), bool), np.ones(3), np.zeros(3), np.eye(3), "a"),
        Correspondence("a", "b", np.arange(4), weights, np.arange(4), points),
        ShapePath("a", "b", np.linspace(0, 1, 2), np.zeros((2, 4, 3)), np.zeros((2, 4, 3)), points),
        CorrespondedShapes(np.stack([mesh.vertices] * 2), mesh.faces, ("a", "b"), "a"),
        Similarity(2.0, np.eye(3), np.ones(3)),
    ]


@pytest.mark.parametrize("record", small_records(), ids=lambda record: type(record).__name__)
def test_equality_never_raises_and_records_travel_to_other_processes(record: object) -> None:
    assert record == record
    copy = pickle.loads(pickle.dumps(record))
    assert record != copy  # no comparison of arrays
    for name, value in vars(record).items():
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(getattr(copy, name), value)


@pytest.mark.parametrize(
    "record",
    [r for r in small_records() if isinstance(r, Mesh | CorrespondedShapes)],
    ids=lambda record: type(record).__name__,
)
def test_shapes_cannot_be_written_into(record: Mesh | CorrespondedShapes) -> None:
    with pytest.raises(ValueError, match="read-only"):
        record.vertices[0] = 0
    with pytest.raises(ValueError, match="read-only"):
        record.faces[0] = 0


def test_a_mesh_leaves_the_callers_own_array_writable() -> None:
    vertices = np.array(sphere().vertices)
    Mesh(vertices, sphere().faces, "a")
    vertices[0] = 5


@pytest.mark.parametrize(
    ("vertices", "faces", "reason"),
    [
        (np.zeros((3, 2)), [[0, 1, 2]], r"vertices have shape \(3, 2\), not \(V, 3\)"),
        (np.zeros((3, 3)), [[0, 1, 2, 0]], r"faces have shape \(1, 4\), not \(F, 3\)"),
        (np.full((3, 3), np.nan), [[0, 1, 2]], "not finite"),
        (np.zeros((3, 3)), [[0, 1, 3]], "missing vertices"),
        (np.zeros((3, 3)), [[0, 1, -1]], "missing vertices"),
    ],
)
def test_a_mesh_that_is_none_names_its_case(vertices: Any, faces: Any, reason: str) -> None:
    with pytest.raises(CaseError, match=f"case liver_7: .*{reason}"):
        Mesh(vertices, np.array(faces), "liver_7")


@pytest.mark.parametrize(
    ("voxels", "spacing", "reason"),
    [
        (np.zeros((2, 2), bool), [1.0, 1, 1], "2 dimensions; 3 are needed"),
        (np.zeros((2, 2, 2), bool), [1.0, 0, 1], "finite positive"),
        (np.zeros((2, 2, 2), bool), [1.0, np.nan, 1], "finite positive"),
    ],
)
def test_a_mask_that_is_none_names_its_case(voxels: Any, spacing: Any, reason: str) -> None:
    with pytest.raises(CaseError, match=f"case a: .*{reason}"):
        Mask(voxels, np.array(spacing), np.zeros(3), np.eye(3), "a")


def test_a_mask_knows_its_place_and_volume() -> None:
    turned = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # the image's x axis points along y
    spacing, origin = np.array([1.0, 2, 3]), np.array([10.0, 0, 0])
    mask = Mask(np.ones((2, 3, 4), bool), spacing, origin, turned, "a")
    assert mask.volume_mm3 == pytest.approx(2 * 3 * 4 * 6)
    np.testing.assert_allclose(mask.to_world(np.array([1.0, 0, 0])), [10, 1, 0])
    np.testing.assert_allclose(mask.to_world(np.array([0.0, 1, 2])), [8, 0, 6])


def test_errors_of_cases_survive_worker_processes() -> None:
    error = pickle.loads(pickle.dumps(CaseError("a", "is empty")))
    assert (str(error), error.case_id, error.reason) == ("case a: is empty", "a", "is empty")


def test_a_correspondence_gives_points_on_the_case() -> None:
    mesh = blob(0)
    corner = np.eye(3)[[0, 1, 2]]
    match = Correspondence("t", "c", np.array([5, 5, 5]), corner, mesh.faces[5], np.zeros((3, 3)))
    np.testing.assert_allclose(match.points_on(mesh), mesh.vertices[mesh.faces[5]])


def test_a_path_is_linear_between_its_times_and_has_ends() -> None:
    pose = np.array([0.0, 1.0, 4.0])[:, None, None] * np.ones((3, 4, 3))
    path = ShapePath("a", "b", np.array([0, 0.5, 1]), pose, np.ones((3, 4, 3)), np.zeros((1, 3)))
    assert path.at(0.75, 0).mean() == pytest.approx(2.5)
    assert path.at(0.75, 0.5).mean() == pytest.approx(3.0)
    assert path.at(0, 0).mean() == 0
    with pytest.raises(ValueError, match="both must lie in"):
        path.at(1.01)


def test_corresponded_shapes_know_their_template_and_parts() -> None:
    vertices = np.arange(3 * 4 * 3, dtype=float).reshape(3, 4, 3)
    shapes = CorrespondedShapes(vertices, np.array([[0, 1, 2]]), ("a", "b", "c"), "b")
    np.testing.assert_array_equal(shapes.template, vertices[1])
    part = shapes.subset([2, 0])
    assert part.case_ids == ("c", "a")
    np.testing.assert_array_equal(part.vertices, vertices[[2, 0]])
    np.testing.assert_array_equal(part.template, vertices[2])  # its own is not among them
    with pytest.raises(ValueError, match="for 2 cases"):
        CorrespondedShapes(vertices, shapes.faces, ("a", "b"), "a")


def test_a_similarity_and_its_inverse() -> None:
    generator = np.random.default_rng(0)
    turn, _ = np.linalg.qr(generator.standard_normal((3, 3)))
    frame = Similarity(0.3, turn * np.sign(np.linalg.det(turn)), generator.standard_normal(3))
    points = generator.standard_normal((2, 5, 3))
    np.testing.assert_allclose(frame.inverse().apply(frame.apply(points)), points)
    before, after = (np.diff(p, axis=-2) for p in (points, frame.apply(points)))
    np.testing.assert_allclose(
        np.linalg.norm(after, axis=-1), 0.3 * np.linalg.norm(before, axis=-1)
    )

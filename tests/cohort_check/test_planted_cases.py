"""Planted among bodies that are alike: each is found, named, and no other is."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from shapes import blob

from ssm_pipeline.cohort_check.check import check_cohort
from ssm_pipeline.cohort_check.fingerprint import fingerprint, typical_cases
from ssm_pipeline.cohort_check.judge import is_handed, judge, robust_z
from ssm_pipeline.cohort_check.rigid_fit import fit_to
from ssm_pipeline.records import Mesh, StudyError

BODIES = [blob(seed, faces=400) for seed in range(7)]
BODY = blob(11, faces=400)


@pytest.fixture(scope="module")
def cohort() -> tuple[pd.DataFrame, list[Mesh]]:
    """The numbers of the bodies, and the typical ones among them."""
    numbers = pd.DataFrame([fingerprint(mesh) for mesh in BODIES])
    chosen = typical_cases([mesh.case_id for mesh in BODIES], numbers)
    typical = [mesh for mesh in BODIES if mesh.case_id in chosen]
    return pd.DataFrame([numbers_of(mesh, typical) for mesh in BODIES]), typical


def numbers_of(mesh: Mesh, typical: list[Mesh], left_out: float = 0.0) -> dict[str, object]:
    numbers = fingerprint(mesh) | fit_to(mesh, typical, seed=0)
    return {"case_id": mesh.case_id, "left_out_percent": left_out, **numbers}


def remarks_of(
    cohort: tuple[pd.DataFrame, list[Mesh]],
    vertices: np.ndarray,
    faces: np.ndarray = BODY.faces,
    left_out: float = 0.0,
) -> str:
    """What is said of the planted case; nothing may be said of the others."""
    row = numbers_of(Mesh(vertices, faces, "planted"), cohort[1], left_out)
    table = judge(pd.concat([cohort[0], pd.DataFrame([row])], ignore_index=True))
    remarks = table.set_index("case_id")["remarks"]
    others = remarks.drop("planted")
    assert (others == "").all(), others[others != ""].to_dict()
    return str(remarks["planted"])


Cohort = tuple[pd.DataFrame, list[Mesh]]


def test_bodies_that_are_alike_are_not_remarked(cohort: Cohort) -> None:
    assert remarks_of(cohort, BODY.vertices) == ""
    assert is_handed((cohort[0]["mirrored_percent"] / cohort[0]["fit_percent"]).to_numpy())
    assert cohort[0]["turned_deg"].max() < 30


@pytest.mark.parametrize(
    ("scale", "said"),
    [
        (0.1, "0.1 times the others': centimetres?"),
        (0.001, "0.001 times the others': metres?"),
        (10, "10 times the others': are the others in centimetres?"),
        (1.5, "the median is 175 ml"),
    ],
)
def test_another_size(cohort: Cohort, scale: float, said: str) -> None:
    found = remarks_of(cohort, scale * BODY.vertices / 0.995)  # of the median's length
    assert found.startswith("size: ")
    assert found.endswith(said)


def test_a_mirror_image(cohort: Cohort) -> None:
    flip = np.array([-1.0, 1.0, 1.0])
    said = remarks_of(cohort, BODY.vertices * flip, BODY.faces[:, ::-1])
    assert said.startswith("mirrored: ")


@pytest.mark.parametrize("degrees", [90, 180])
def test_a_case_turned_over(cohort: Cohort, degrees: float) -> None:
    turn = Rotation.from_euler("x", degrees, degrees=True).as_matrix()
    said = remarks_of(cohort, BODY.vertices @ turn.T)
    assert said.startswith("turned: it lies best at ")
    found = float(said.removeprefix("turned: it lies best at ").split("°")[0])
    assert abs(found - degrees) < 25  # of bodies that differ by 8 % of their radius


def test_a_plate(cohort: Cohort) -> None:
    plate = trimesh.creation.box((120, 90, 4)).subdivide().subdivide().subdivide()
    said = remarks_of(cohort, plate.vertices, plate.faces)
    assert "flat or ragged" in said
    assert "another shape" in said


def test_another_organ(cohort: Cohort) -> None:
    ring = trimesh.creation.torus(30, 12, major_sections=40, minor_sections=20)
    assert "another shape" in remarks_of(cohort, ring.vertices, ring.faces)


def test_pieces_left_out(cohort: Cohort) -> None:
    said = remarks_of(cohort, BODY.vertices, left_out=48.0)
    assert said == "several pieces: 48 % of it was left out"


def test_the_sides_of_an_even_body_can_not_be_told() -> None:
    assert not is_handed(np.array([1.28, 1.08, 0.99, 1.15, 1.1, 1.02, 1.2, 1.05, 0.82]))
    of_both_sides = np.array([1.9, 1.8, 2.0, 0.5, 0.55, 0.52, 1.9])
    assert is_handed(of_both_sides)


def test_the_same_organ_twice_by_another_mesh_and_mirrored() -> None:
    moved = Rotation.from_euler("xyz", [10, 20, -15], degrees=True).as_matrix()
    finer = trimesh.Trimesh(BODY.vertices @ moved.T + 40, BODY.faces).subdivide()
    image = Mesh(BODIES[4].vertices * [-1, 1, 1], BODIES[4].faces[:, ::-1], "image")
    copy = dataclasses.replace(BODIES[2], case_id="copy")
    meshes = [BODIES[2], copy, BODY, Mesh(finer.vertices, finer.faces, "finer"), BODIES[4], image]
    table = check_cohort(meshes).set_index("case_id")["remarks"]
    assert table["copy"] == f"the same as {BODIES[2].case_id}"
    assert table[BODIES[2].case_id] == "the same as copy"
    assert table["finer"] == f"the same as {BODY.case_id}"
    assert f"the mirror image of {BODIES[4].case_id}" in table["image"]


def test_two_cases_are_too_few_to_call_one_odd() -> None:
    table = check_cohort([BODY, Mesh(10 * BODIES[0].vertices, BODIES[0].faces, "large")])
    assert (table["remarks"] == "").all()
    with pytest.raises(StudyError, match="at least 2"):
        check_cohort([BODY])


def test_robust_z_is_of_the_median_and_its_deviation() -> None:
    values = np.array([1.0, 2.0, 3.0, 4.0, 100.0])
    np.testing.assert_allclose(robust_z(values), (values - 3) / 1.4826)
    assert np.abs(robust_z(np.log([1.0, 1.01, 0.99, 1.1]))).max() < 5  # all alike: none is odd

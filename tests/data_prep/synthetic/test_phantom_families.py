"""The families lung and tube: not affine, unfolded, known at every point, faulty as scans are."""

import dataclasses
import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pymeshlab
import pytest
import yaml
from loading import loaded_mask

from ssm_pipeline import storage
from ssm_pipeline.data_prep.synthetic.phantom_cases import draw_cases, family_named
from ssm_pipeline.data_prep.synthetic.phantom_family import PhantomFamily
from ssm_pipeline.data_prep.synthetic.phantom_seeds import DEVELOPMENT, REPORTED
from ssm_pipeline.data_prep.synthetic.phantom_settings import PhantomSettings
from ssm_pipeline.data_prep.synthetic.phantoms import (
    draw_truth,
    make_cohort,
    read_cohort,
)
from ssm_pipeline.geometry.affine import affine_share
from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.geometry.surface import face_normals, volume
from ssm_pipeline.geometry.topology import euler_number, is_oriented_manifold
from ssm_pipeline.meshing.mask_to_mesh import mesh_with_quality
from ssm_pipeline.meshing.settings import MeshingSettings
from ssm_pipeline.records import Cohort, StudyError

ROOT = Path(__file__).parents[3]
FAMILIES = ("lung", "tube")


def thinned(name: str, step: int) -> PhantomFamily:
    """A family of fewer points, whose cases are quick to draw and can't be scanned."""
    family = family_named(name)
    return dataclasses.replace(
        family,
        vertices=family.vertices[::step],
        border=family.border[::step],
        hilum=np.unique(family.hilum // step),
    )


@pytest.fixture(scope="module", params=FAMILIES)
def cohort(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Cohort:
    spacing = (2.5, 2.5, 3.0) if request.param == "lung" else None
    settings = PhantomSettings(family=request.param, cases=2, spacing_mm=spacing, cut_share=0)
    return make_cohort(tmp_path_factory.mktemp(request.param), settings)


@pytest.mark.parametrize(
    ("family", "litres", "vertices"), [("lung", (2.0, 3.2), 9000), ("tube", (2e-3, 4e-3), 3500)]
)
def test_the_mean_is_a_closed_organ_of_real_size(family: str, litres: Any, vertices: int) -> None:
    made = family_named(family)
    assert len(made.vertices) == pytest.approx(vertices, rel=0.2)
    assert is_oriented_manifold(made.faces)
    assert euler_number(made.faces) == 2
    assert litres[0] < volume(made.vertices, made.faces) / 1e6 < litres[1]
    assert 0.3 < (made.border < 0).mean() < 0.7  # both labels hold a fair part


def test_the_mean_lung_is_not_star_shaped() -> None:
    """From no point of a coarse search within the lung is its whole surface seen."""
    made = family_named("lung")
    normals, centres = face_normals(made.vertices, made.faces), made.vertices[made.faces].mean(1)
    from_points = made.vertices.mean(axis=0) + 15 * np.argwhere(np.ones((5, 5, 7))) - [30, 30, 45]
    hidden = [(np.einsum("fd,fd->f", normals, centres - p) < 0).mean() for p in from_points]
    assert min(hidden) > 0.01


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("seed", DEVELOPMENT)
def test_at_most_a_third_is_affine(family: Any, seed: int) -> None:
    # Every tenth vertex: the same share to within a percent, in a tenth of the time.
    cases = draw_cases(thinned(family, 10), PhantomSettings(family=family, cases=10, seed=seed))
    assert affine_share(np.stack([case.vertices for case in cases])) < 1 / 3


def test_the_smooth_lungs_were_nearly_affine() -> None:
    truth = draw_truth(PhantomSettings(family="smooth", cases=10))
    assert affine_share(truth.vertices) > 0.8


def faces_that_meet(vertices: np.ndarray, faces: np.ndarray) -> int:
    """The fewest of three counts: MeshLab once counted some where there were none."""
    counts = []
    for _ in range(3):
        meshes = pymeshlab.MeshSet()
        meshes.add_mesh(pymeshlab.Mesh(vertices, faces))
        meshes.compute_selection_by_self_intersections_per_face()
        counts.append(int(meshes.current_mesh().selected_face_number()))
    return min(counts)


def test_the_check_sees_a_surface_that_meets_itself() -> None:
    made = family_named("tube")
    bent = made.vertices.copy()
    bent[made.vertices[:, 1] > 10] -= [0, 12.0, 0]
    assert faces_that_meet(bent, made.faces) > 0


@pytest.mark.parametrize("family", FAMILIES)
def test_no_case_is_folded_and_each_has_a_residual_of_its_own(family: Any) -> None:
    settings = PhantomSettings(family=family, cases=3, seed=2)
    made = family_named(family)
    truth = draw_truth(settings)
    modes = truth.modes.reshape(len(truth.modes), -1)
    left_over = []
    for case, frame in zip(truth.vertices, truth.frames, strict=True):
        assert volume(case, truth.faces) > 0.4 * volume(made.vertices, made.faces)
        assert faces_that_meet(case, truth.faces) == 0
        moved = (frame.inverse().apply(case) - made.vertices).ravel()
        scores = np.linalg.lstsq(modes.T, moved, rcond=None)[0]
        rest = (moved - scores @ modes).reshape(-1, 3)
        left_over.append(np.sqrt((rest**2).sum(axis=1).mean()))
    assert min(left_over) > 0.5 * made.residual_mm


def test_a_case_stays_the_same_in_a_larger_cohort() -> None:
    few, many = (
        draw_truth(PhantomSettings(family="tube", cases=count, seed=4)) for count in (2, 5)
    )
    np.testing.assert_array_equal(few.vertices, many.vertices[:2])


def test_faults_come_as_often_as_asked() -> None:
    lung = thinned("lung", 20)
    settings = PhantomSettings(cases=30, bridge_share=0.5, cut_share=0.5, residual_mm=0, modes=1)
    cases = draw_cases(lung, settings)
    assert 8 <= sum(bool(case.handles) for case in cases) <= 22
    truth_seen = [case.view.holds(case.vertices).mean() for case in cases]
    cut = [share for share in truth_seen if share < 1]
    assert 8 <= len(cut) <= 22
    assert min(cut) > 0.8
    assert len({case.spacing_mm for case in cases}) == 30
    assert all(1.25 <= case.spacing_mm[2] <= 3 for case in cases)


def test_scans_hold_the_true_solids_with_two_labels(cohort: Cohort) -> None:
    truth = cohort.truth
    assert truth is not None
    assert truth.labels is not None
    for case, vertices in zip(cohort.cases, truth.vertices, strict=True):
        mask = loaded_mask(case)
        assert mask.warnings == ()
        assert mask.volume_mm3 == pytest.approx(volume(vertices, truth.faces), rel=0.03)
        mesh, quality = mesh_with_quality(mask, MeshingSettings(faces=1500))
        assert quality.euler_number == 2
        distances = closest_points(mesh.vertices, vertices, truth.faces).distances
        # Half a voxel of noise at the border; rounded edges and bridges a little more.
        assert distances.mean() < 0.35 * mask.spacing_mm.mean()


def test_the_folder_says_how_affine_it_is(cohort: Cohort) -> None:
    truth = cohort.truth
    assert truth is not None
    stated = storage.read_json(cohort.cases[0].files[0].with_name("phantoms.json"))
    assert stated["affine_share"] == pytest.approx(affine_share(truth.vertices), abs=1e-3)


def test_same_settings_same_bytes(tmp_path: Path) -> None:
    def digests(folder: Path) -> list[str]:
        make_cohort(folder, PhantomSettings(family="tube", cases=2, seed=6))
        return [hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(folder.glob("*.mha"))]

    first = digests(tmp_path / "a")
    assert first == digests(tmp_path / "b")
    assert first[0] != first[1]


def test_another_family_replaces_the_folder(tmp_path: Path) -> None:
    make_cohort(tmp_path, PhantomSettings(family="tube", cases=3))
    coarse = PhantomSettings(family="smooth", cases=2, spacing_mm=(4, 4, 4))
    assert len(make_cohort(tmp_path, coarse).cases) == 2
    assert not list(tmp_path.glob("*.mha"))
    truth = read_cohort(tmp_path).truth
    assert truth is not None
    assert truth.labels is None


def test_more_modes_than_there_are_is_refused() -> None:
    with pytest.raises(StudyError, match=r"99 modes asked of the phantom family tube, which has"):
        draw_truth(PhantomSettings(family="tube", modes=99))


def seeds_in(content: object) -> set[object]:
    """Every value that a settings file gives to a key named seed or seeds, at any depth."""
    found: set[object] = set()
    if isinstance(content, dict):
        for name, value in content.items():
            if name in ("seed", "seeds"):
                found |= set(value) if isinstance(value, list) else {value}
            found |= seeds_in(value)
    if isinstance(content, list):
        found = found.union(*map(seeds_in, content))
    return found


def test_reported_seeds_are_no_development_seeds() -> None:
    assert not set(DEVELOPMENT) & set(REPORTED)
    assert len(DEVELOPMENT) >= 3
    assert len(REPORTED) >= 3


@pytest.mark.parametrize(
    "path",
    [p for p in sorted((ROOT / "workflows").rglob("*.yaml")) if not p.stem.startswith("results")],
    ids=lambda path: path.stem,
)
def test_no_settings_file_names_a_reported_seed(path: Path) -> None:
    assert not seeds_in(yaml.safe_load(path.read_text())) & set(REPORTED)


def test_the_check_sees_a_reported_seed() -> None:
    content = {"without_data": {"data": {"seed": REPORTED[0]}}, "x": [{"seeds": [7]}]}
    assert seeds_in(content) == {REPORTED[0], 7}

"""Folders of phantoms, and the smooth lungs: exact truth, the same bytes for the same seed."""

import hashlib
from pathlib import Path

import numpy as np
import pytest
from loading import loaded_mask
from scipy.spatial.transform import Rotation

from ssm_pipeline.data_prep.synthetic.phantom_pose import turn_angle
from ssm_pipeline.data_prep.synthetic.phantom_settings import PhantomSettings
from ssm_pipeline.data_prep.synthetic.phantoms import make_cohort, read_cohort
from ssm_pipeline.data_prep.synthetic.smooth_lung import CENTRE, mean_lung, mode_fields
from ssm_pipeline.data_prep.synthetic.smooth_phantoms import MAX_SCORE_NORM, draw
from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.geometry.surface import area, face_normals, volume
from ssm_pipeline.geometry.topology import euler_number, is_oriented_manifold
from ssm_pipeline.meshing.mask_to_mesh import mesh_with_quality
from ssm_pipeline.meshing.settings import MeshingSettings
from ssm_pipeline.records import Cohort, StudyError

SMALL = PhantomSettings(
    family="smooth", cases=2, spacing_mm=(2.0, 2.0, 3.0), max_rotation_deg=15, seed=3
)


@pytest.fixture(scope="module")
def cohort(tmp_path_factory: pytest.TempPathFactory) -> Cohort:
    return make_cohort(tmp_path_factory.mktemp("phantoms"), SMALL)


def test_the_mean_is_a_closed_lung_of_real_size() -> None:
    vertices, faces = mean_lung()
    assert len(vertices) == 10_242
    assert is_oriented_manifold(faces)
    assert euler_number(faces) == 2
    assert 2e6 < volume(vertices, faces) < 3e6
    # Real left lungs of this volume measure 1040 to 1320 cm²; a ball 850, the phantom is smoother.
    assert 9e4 < area(vertices, faces) < 13e4
    # Star-shaped: every triangle faces away from the origin of its rays.
    away = np.einsum(
        "fd,fd->f", face_normals(vertices, faces), vertices[faces].mean(axis=1) - CENTRE
    )
    assert (away > 0).all()


def test_no_scores_can_fold_the_lung() -> None:
    """Sum over modes of |score| × gradient stays below 1, so x → x + Σ s v(x) is injective."""
    generator = np.random.default_rng(0)
    points = CENTRE + generator.uniform([-75, -100, -145], [75, 100, 145], (20_000, 3))
    step = 1e-3
    largest = []
    for field in mode_fields():
        gradient = np.stack(
            [
                (field(points + offset) - field(points - offset)) / (2 * step)
                for offset in step * np.eye(3)
            ],
            axis=2,
        )
        symmetric = (gradient + gradient.transpose(0, 2, 1)) / 2
        largest.append(np.abs(np.linalg.eigvalsh(symmetric)).max())
    # Cauchy-Schwarz: Σ |s_m| g_m ≤ ‖s‖ ‖g‖.
    assert MAX_SCORE_NORM * np.linalg.norm(largest) < 1


@pytest.mark.parametrize("sign", [-3.0, 3.0])
@pytest.mark.parametrize("mode", range(6))
def test_three_standard_deviations_turn_no_triangle(mode: int, sign: float) -> None:
    mean, faces = mean_lung(subdivisions=4)
    moved = mean + sign * mode_fields()[mode](mean)
    assert 1e6 < volume(moved, faces) < 4e6
    before, after = face_normals(mean, faces), face_normals(moved, faces)
    assert (np.einsum("fd,fd->f", before, after) > 0).all()
    rms = np.sqrt(((moved - mean) ** 2).sum(axis=1).mean()) / 3
    assert 1.5 < rms < 15


def test_truth_is_mean_plus_modes_then_frame() -> None:
    truth, right = draw(PhantomSettings(cases=4, modes=3, max_rotation_deg=20))
    assert truth.modes.shape == (3, 10_242, 3)
    assert right.shape == truth.vertices.shape
    for vertices, scores, frame in zip(truth.vertices, truth.scores, truth.frames, strict=True):
        inner = frame.inverse().apply(vertices)
        np.testing.assert_allclose(
            inner - truth.mean, np.einsum("m,mvd->vd", scores, truth.modes), atol=1e-9
        )
        assert np.linalg.det(frame.rotation) == pytest.approx(1)
        turn = np.degrees(np.arccos((np.trace(frame.rotation) - 1) / 2))
        assert turn <= 20


def test_turns_are_even_over_all_rotations_allowed() -> None:
    largest = np.radians(40)
    angles = Rotation.random(400_000, rng=np.random.default_rng(0)).magnitude()
    angles = angles[angles <= largest]
    assert len(angles) > 5000
    for share in (0.1, 0.5, 0.9):
        angle = turn_angle(share, largest)
        assert (angles < angle).mean() == pytest.approx(share, abs=0.02)
    assert turn_angle(0.7, 0.0) == 0.0
    assert turn_angle(1.0, largest) == pytest.approx(largest)


def test_as_scanned_frames_are_the_identity() -> None:
    truth, _ = draw(PhantomSettings(cases=2, translation_mm=0))
    for frame in truth.frames:
        np.testing.assert_allclose(frame.apply(truth.mean), truth.mean, atol=1e-10)


def test_the_number_of_modes_is_the_rank() -> None:
    truth, _ = draw(PhantomSettings(cases=12, translation_mm=0))
    flat = truth.vertices.reshape(12, -1)
    singular = np.linalg.svd(flat - flat.mean(axis=0), compute_uv=False)
    assert (singular > 1e-6 * singular[0]).sum() == 5
    spread_mm = np.sqrt(((truth.vertices - truth.vertices.mean(axis=0)) ** 2).sum(axis=2).mean())
    assert 5 < spread_mm < 25  # patients' lungs differ by a centimetre or two


def test_scores_are_standard_normal() -> None:
    truth, _ = draw(PhantomSettings(cases=200, modes=1, seed=1))
    assert abs(truth.scores.mean()) < 3 / np.sqrt(200)
    assert 0.85 < truth.scores.std() < 1.15


def test_masks_hold_the_true_solids(cohort: Cohort) -> None:
    truth = cohort.truth
    assert truth is not None
    assert truth.case_ids == tuple(case.case_id for case in cohort.cases)
    for case, vertices in zip(cohort.cases, truth.vertices, strict=True):
        mask = loaded_mask(case)
        assert mask.warnings == ()
        # About 200 000 voxels: the sampled volume is good to a tenth of a percent.
        assert mask.volume_mm3 == pytest.approx(volume(vertices, truth.faces), rel=2e-3)
        mesh, quality = mesh_with_quality(mask, MeshingSettings(faces=2000))
        assert quality.euler_number == 2
        distances = closest_points(mesh.vertices, vertices, truth.faces).distances
        # The blur rounds the sharp rim of the base; elsewhere a fraction of a 2 mm voxel.
        assert distances.mean() < 0.3


def test_right_lungs_lie_to_the_right(cohort: Cohort) -> None:
    from ssm_pipeline.data_prep.cohorts import luna16

    folder = cohort.cases[0].files[0].parent
    left, right = (
        loaded_mask(luna16.find_cases(folder, side=side).cases[0]) for side in ("left", "right")
    )
    left_x, right_x = (
        mask.to_world(np.argwhere(mask.voxels).mean(axis=0)[::-1])[0] for mask in (left, right)
    )
    assert left_x > right_x + 50
    assert not (left.voxels & right.voxels).any()


def test_same_settings_same_bytes_and_no_second_writing(cohort: Cohort, tmp_path: Path) -> None:
    folder = cohort.cases[0].files[0].parent

    def digests(place: Path) -> dict[str, str]:
        return {
            p.name: hashlib.sha256(p.read_bytes()).hexdigest()
            for p in place.iterdir()
            if p.suffix != ".npz"
        }  # npz files carry the time

    make_cohort(tmp_path / "again", SMALL)
    assert digests(folder) == digests(tmp_path / "again")
    first, second = read_cohort(folder).truth, read_cohort(tmp_path / "again").truth
    assert first is not None
    assert second is not None
    np.testing.assert_array_equal(first.vertices, second.vertices)
    stamps = {path: path.stat().st_mtime_ns for path in folder.iterdir()}
    make_cohort(folder, SMALL)
    assert stamps == {path: path.stat().st_mtime_ns for path in folder.iterdir()}


def test_other_settings_replace_the_folder(tmp_path: Path) -> None:
    coarse = SMALL.model_copy(update={"spacing_mm": (4.0, 4.0, 4.0)})
    make_cohort(tmp_path, coarse.model_copy(update={"cases": 3}))
    assert len(make_cohort(tmp_path, coarse).cases) == 2
    assert len(list(tmp_path.glob("*.mhd"))) == 2


def test_foreign_masks_are_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "1.2.3.mhd").touch()
    with pytest.raises(StudyError, match="not phantoms"):
        make_cohort(tmp_path, SMALL)
    with pytest.raises(StudyError, match="no finished phantom cohort"):
        read_cohort(tmp_path)

"""LUNA16's layout: sides, subsets, ids; on written files and on the real ones where present."""

import pickle
from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk
from loading import loaded_mask

from ssm_pipeline.data_prep.cohorts.luna16 import find_cases
from ssm_pipeline.data_prep.cohorts.selection import Choice
from ssm_pipeline.records import StudyError

REAL = Path(__file__).parents[4] / "shared" / "data" / "luna16"
needs_real = pytest.mark.skipif(
    not REAL.is_dir(), reason="the real LUNA16 masks (../shared/data/luna16) are not here"
)


def write_scan(folder: Path, uid: str, swapped: bool = False) -> None:
    labels = np.zeros((12, 12, 30), np.uint8)
    labels[2:9, 2:10, 3:9], labels[2:9, 2:10, 18:26] = (3, 4) if swapped else (4, 3)
    folder.mkdir(parents=True, exist_ok=True)
    sitk.WriteImage(sitk.GetImageFromArray(labels), folder / f"{uid}.mhd", useCompression=True)


@pytest.fixture
def download(tmp_path: Path) -> Path:
    for uid in ("1.2.30", "1.2.4", "1.2.5"):
        write_scan(tmp_path / "seg-lungs-LUNA16", uid)
    return tmp_path


def test_masks_here_or_in_the_subfolder(download: Path) -> None:
    outer, inner = find_cases(download), find_cases(download / "seg-lungs-LUNA16")
    assert [c.case_id for c in outer.cases] == ["1.2.30", "1.2.4", "1.2.5"]
    assert [c.files for c in outer.cases] == [c.files for c in inner.cases]
    assert {path.suffix for path in outer.cases[0].files} == {".mhd", ".zraw"}
    assert not outer.is_synthetic


def test_sides(download: Path) -> None:
    left = loaded_mask(find_cases(download).cases[0])
    right = loaded_mask(find_cases(download, side="right").cases[0])
    assert np.argwhere(left.voxels)[:, 2].min() == 18
    assert np.argwhere(right.voxels)[:, 2].max() == 8
    both = find_cases(download, side="both", choice=Choice(limit=1)).cases
    assert [case.case_id for case in both] == ["1.2.30.left", "1.2.30.right"]
    np.testing.assert_array_equal(loaded_mask(both[1]).voxels, right.voxels)


def test_swapped_sides_are_told(tmp_path: Path) -> None:
    write_scan(tmp_path, "1.2.3", swapped=True)
    (warning,) = find_cases(tmp_path).cases[0].load().warnings
    assert "sides may be swapped" in warning


def test_cases_and_limit(download: Path) -> None:
    named = find_cases(download, choice=Choice(cases=("1.2.5", "1.2.30")))
    assert [case.case_id for case in named.cases] == ["1.2.5", "1.2.30"]
    assert len(find_cases(download, choice=Choice(limit=2)).cases) == 2
    with pytest.raises(StudyError, match=r"no case 1\.2\.31 among the 3.*Did you mean 1\.2\.30"):
        find_cases(download, choice=Choice(cases=("1.2.31",)))
    with pytest.raises(StudyError, match="named twice"):
        find_cases(download, choice=Choice(cases=("1.2.4", "1.2.4")))
    with pytest.raises(StudyError, match="limit is 0"):
        find_cases(download, choice=Choice(limit=0))


def test_subset(download: Path) -> None:
    with pytest.raises(StudyError, match=r"there is no folder .*subset9"):
        find_cases(download, subset=9)
    (download / "subset9").mkdir()
    with pytest.raises(StudyError, match="none of the masks"):
        find_cases(download, subset=9)
    (download / "subset9" / "1.2.4.mhd").touch()
    assert [case.case_id for case in find_cases(download, subset=9).cases] == ["1.2.4"]


def test_two_files_of_one_id(download: Path) -> None:
    (download / "seg-lungs-LUNA16" / "1.2.4.nrrd").touch()
    with pytest.raises(StudyError, match=r"two files share the case id 1\.2\.4"):
        find_cases(download)


def test_nothing_there(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match="there are no masks"):
        find_cases(tmp_path)
    with pytest.raises(StudyError, match="there is no folder"):
        find_cases(tmp_path / "absent")


def test_a_case_travels_to_a_worker(download: Path) -> None:
    case = pickle.loads(pickle.dumps(find_cases(download).cases[0]))
    assert case.load().voxels.any()


@needs_real
def test_real_left_lungs_lie_to_the_left() -> None:
    cohort = find_cases(REAL, side="both")
    assert len(cohort.cases) == 44
    for left, right in zip(cohort.cases[6:8:2], cohort.cases[7:9:2], strict=True):
        left_mask, right_mask = loaded_mask(left), loaded_mask(right)
        left_x, right_x = (
            mask.to_world(np.argwhere(mask.voxels[::4, ::4, ::4]).mean(axis=0)[::-1] * 4)[0]
            for mask in (left_mask, right_mask)
        )
        assert left_x > right_x + 50
        assert 0.4e6 < left_mask.volume_mm3 < 4.2e6
        assert not any("swapped" in warning for warning in left_mask.warnings)


@needs_real
def test_luna16s_own_files() -> None:
    cohort = find_cases(REAL / "seg-lungs-original")
    assert len(cohort.cases) == 2
    mask = loaded_mask(cohort.cases[0])
    assert mask.voxels.shape == (121, 512, 512)
    np.testing.assert_allclose(mask.spacing_mm, [0.76171875, 0.76171875, 2.5], rtol=1e-6)
    np.testing.assert_allclose(mask.origin_mm, [-198.100006, -195, -335.209991])
    assert 0.4e6 < mask.volume_mm3 < 4.2e6


def test_right_lungs_mirrored_and_a_scan_excluded(download: Path) -> None:
    plain = find_cases(download, side="both")
    choice = Choice(mirror="right", exclude={"1.2.4": "motion"})
    cohort = find_cases(download, side="both", choice=choice)
    assert [case.case_id for case in cohort.cases][:2] == ["1.2.30.left", "1.2.30.right"]
    assert [case.patient for case in cohort.cases] == ["1.2.30"] * 2 + ["1.2.5"] * 2
    assert [case.case_id for case in cohort.dropped] == ["1.2.4.left", "1.2.4.right"]
    left, right = loaded_mask(cohort.cases[0]), loaded_mask(cohort.cases[1])
    np.testing.assert_array_equal(left.origin_mm, loaded_mask(plain.cases[0]).origin_mm)
    there = loaded_mask(plain.cases[1])
    index = np.argwhere(there.voxels)[:, ::-1].astype(float)
    np.testing.assert_allclose(right.to_world(index), there.to_world(index) * [-1, 1, 1])

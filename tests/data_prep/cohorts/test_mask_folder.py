"""A folder of masks: ids, patterns, duplicates."""

from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk
from loading import loaded_mask

from ssm_pipeline.data_prep.cohorts.mask_folder import Organ, find_cases
from ssm_pipeline.data_prep.cohorts.selection import Choice
from ssm_pipeline.records import StudyError

HIPPOCAMPI = Path(__file__).parents[4] / "shared" / "data" / "msd_hippocampus" / "labelsTr"


def write(path: Path, label: int = 1) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    labels = np.zeros((12, 12, 12), np.uint8)
    labels[2:9, 2:9, 2:9] = label
    sitk.WriteImage(sitk.GetImageFromArray(labels), path)


def test_one_file_a_case(tmp_path: Path) -> None:
    for name in ("b.nii.gz", "a.nrrd", "c.1.2.mha", "._b.nii.gz", "notes.txt"):
        if name == "notes.txt" or name.startswith("."):
            (tmp_path / name).touch()
        else:
            write(tmp_path / name)
    cohort = find_cases(tmp_path)
    assert [case.case_id for case in cohort.cases] == ["a", "b", "c.1.2"]
    assert cohort.name == tmp_path.name
    assert cohort.cases[1].load().case_id == "b"


def test_total_segmentator_layout(tmp_path: Path) -> None:
    for subject in ("s0011", "s0004"):
        write(tmp_path / subject / "liver.nii.gz")
        write(tmp_path / subject / "spleen.nii.gz")
    cohort = find_cases(tmp_path, Organ(name="liver"), "*/liver.nii.gz")
    assert [case.case_id for case in cohort.cases] == ["s0004", "s0011"]
    assert all(case.files[0].name == "liver.nii.gz" for case in cohort.cases)
    cohort = find_cases(tmp_path, pattern="*/sp*.nii.gz")
    assert [case.case_id for case in cohort.cases] == ["s0004", "s0011"]


@pytest.mark.parametrize(
    "pattern",
    ["*/segmentations/liver.nii.gz", "**/liver.nii.gz", "*/*/liver.nii.gz", "s*/seg*/liver*"],
)
def test_ids_come_from_the_parts_of_the_path_that_differ(tmp_path: Path, pattern: str) -> None:
    for subject in ("s0000", "s0001"):
        write(tmp_path / subject / "segmentations" / "liver.nii.gz")
    cohort = find_cases(tmp_path, pattern=pattern)
    assert [case.case_id for case in cohort.cases] == ["s0000", "s0001"]


def test_duplicate_ids(tmp_path: Path) -> None:
    write(tmp_path / "a.nii.gz")
    write(tmp_path / "a.nrrd")
    with pytest.raises(StudyError, match=r"two files share the case id a: .*a\.nii\.gz.*a\.nrrd"):
        find_cases(tmp_path)
    assert len(find_cases(tmp_path, pattern="*.nrrd").cases) == 1


def test_nothing_matches(tmp_path: Path) -> None:
    write(tmp_path / "a.nii.gz")
    with pytest.raises(StudyError, match=r"that match \*\.mhd"):
        find_cases(tmp_path, pattern="*.mhd")
    with pytest.raises(StudyError, match="there is no folder"):
        find_cases(tmp_path / "absent")


@pytest.mark.skipif(not HIPPOCAMPI.is_dir(), reason="../shared/data/msd_hippocampus is not here")
def test_real_hippocampi() -> None:
    cohort = find_cases(HIPPOCAMPI, Organ((1, 2), name="hippocampus"))
    assert len(cohort.cases) == 60
    mask = loaded_mask(cohort.cases[0])
    assert mask.case_id == "hippocampus_003"
    assert 2e3 < mask.volume_mm3 < 5e3


def test_bids_derivatives_are_named_by_subject_and_session(tmp_path: Path) -> None:
    for name in (
        "sub-02/anat/sub-02_T1w_desc-manual_dseg.nii.gz",
        "sub-01/ses-b/anat/sub-01_ses-b_space-orig_dseg.nii.gz",
        "sub-01/ses-a/anat/sub-01_ses-a_space-orig_dseg.nii.gz",
        "sub-01/ses-a/anat/sub-01_ses-a_T1w.nii.gz",
    ):
        write(tmp_path / name)
    cohort = find_cases(tmp_path, pattern="sub-*/**/*_dseg.nii.gz")
    assert [case.case_id for case in cohort.cases] == ["sub-01_ses-a", "sub-01_ses-b", "sub-02"]


def test_two_files_of_one_bids_session(tmp_path: Path) -> None:
    for space in ("orig", "MNI"):
        write(tmp_path / f"sub-01/anat/sub-01_space-{space}_dseg.nii.gz")
    with pytest.raises(StudyError, match="two files share the case id sub-01"):
        find_cases(tmp_path, pattern="sub-*/**/*_dseg.nii.gz")
    assert len(find_cases(tmp_path, pattern="sub-*/**/*space-MNI_dseg.nii.gz").cases) == 1


def test_visits_and_sides_of_one_patient_belong_together(tmp_path: Path) -> None:
    for side in "LR":
        write(tmp_path / f"sub-01/anat/sub-01_hemi-{side}_dseg.nii.gz")
    cohort = find_cases(tmp_path, pattern="sub-*/**/*_dseg.nii.gz", choice=Choice(mirror="right"))
    left, right = cohort.cases
    assert (left.case_id, right.case_id) == ("sub-01_hemi-L", "sub-01_hemi-R")
    assert left.patient == right.patient == "sub-01"
    one, other = loaded_mask(left), loaded_mask(right)
    index = np.argwhere(one.voxels)[:, ::-1].astype(float)
    np.testing.assert_allclose(other.to_world(index), one.to_world(index) * [-1, 1, 1])


def test_the_background_is_no_organ(tmp_path: Path) -> None:
    write(tmp_path / "a.nii.gz")
    with pytest.raises(StudyError, match="label 0 is the background"):
        find_cases(tmp_path, Organ((0, 1)))

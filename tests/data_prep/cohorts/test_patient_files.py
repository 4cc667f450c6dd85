"""Ids of new patients' files, and links that lead nowhere."""

from __future__ import annotations

from pathlib import Path

import pytest

from ssm_pipeline.data_prep.cohorts import mask_folder, surface_folder
from ssm_pipeline.data_prep.cohorts.patient_files import patient_files
from ssm_pipeline.records import StudyError


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def make(*names: str) -> list[Path]:
    files = [Path(name) for name in names]
    for file in files:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(b"none")
    return files


def test_files_with_one_name_get_the_parts_of_their_paths_that_differ() -> None:
    files = make("p1/liver.nii.gz", "p2/liver.nii.gz")
    assert list(patient_files(files).files) == ["p1", "p2"]
    assert list(patient_files(files[:1]).files) == ["liver"]
    assert list(patient_files([files[0], Path("./p1/../p1/liver.nii.gz")]).files) == ["liver"]
    inside = make("a/liver.ply", "liver.ply")
    with pytest.raises(StudyError, match=r"two files are called liver: .*a/liver\.ply and "):
        patient_files(inside)


def test_a_folder_stands_for_the_masks_and_surfaces_below_it() -> None:
    make("new/s2/seg/liver.nii.gz", "new/s1/seg/liver.nii.gz", "new/s1/seg/notes.txt")
    make("new/s1/seg/._liver.nii.gz")
    found = patient_files([Path("new")])
    assert {name: path.parts[-3] for name, path in found.files.items()} == {"s1": "s1", "s2": "s2"}
    make("other/notes.txt")
    with pytest.raises(StudyError, match="other holds no mask and no surface"):
        patient_files([Path("other")])


def test_ids_that_cannot_name_a_folder_are_left_out() -> None:
    (case,) = patient_files(make("fits.csv.ply", "good.ply")).left_out
    assert case.case_id == "fits.csv"
    assert "Rename the file" in case.reason


@pytest.mark.parametrize(
    ("suffix", "find"), [(".nii.gz", mask_folder.find_cases), (".ply", surface_folder.find_cases)]
)
def test_links_that_lead_nowhere_are_counted(suffix: str, find: object) -> None:
    assert callable(find)
    make(f"cases/here{suffix}")
    link = Path(f"cases/gone{suffix}")
    link.symlink_to(f"moved{suffix}")
    cohort = find(Path("cases"))
    assert [case.case_id for case in cohort.cases] == ["here"]
    assert [case.case_id for case in cohort.dropped] == ["gone"]
    assert f"a link to moved{suffix}, which does not exist" in cohort.dropped[0].reason
    (case,) = patient_files([Path("cases")]).left_out
    assert case.case_id == "gone"

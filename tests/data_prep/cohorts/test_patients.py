"""A table of patients, and ids that look like several cases of one patient."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk

from ssm_pipeline.data_prep.cohorts.patients import advice_on_patients, likely_patients
from ssm_pipeline.records import StudyError
from ssm_pipeline.study.sources import Luna16Data, MaskFolderData, MeshFolderData

IDS = ("P04_v1", "P04_v2", "P05_left", "P05_right", "P06_baseline", "P06_followup", "P07")


def masks(folder: Path) -> Path:
    folder.mkdir()
    for number, name in enumerate(IDS):
        labels = np.zeros((9, 9, 9), np.uint8)
        labels[2 : 4 + number % 4, 2:5, 2 : 4 + number // 4] = 1
        sitk.WriteImage(sitk.GetImageFromArray(labels), folder / f"{name}.nii.gz")
    return folder


def test_a_table_gives_each_case_its_patient_and_ids_stay_text(tmp_path: Path) -> None:
    rows = "".join(f"{name},0{number // 2},v{number % 2}\n" for number, name in enumerate(IDS))
    (tmp_path / "p.csv").write_text("case,patient,visit\n" + rows + "not_in_this_study,09,v1\n")
    data = MaskFolderData(folder=masks(tmp_path / "m"), patients=tmp_path / "p.csv")
    cases = data.find(Path()).cases
    assert {case.case_id: case.patient for case in cases} == {
        name: f"0{number // 2}" for number, name in enumerate(IDS)
    }
    assert [case.visit for case in cases] == ["v0", "v1", "v0", "v1", "v0", "v1", "v0"]
    assert all(case.site == "" for case in cases)
    excluded = data.model_copy(update={"exclude": {"00": "withdrawn"}}).find(Path())
    assert [case.case_id for case in excluded.dropped] == ["P04_v1", "P04_v2"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("case,visit\nP04_v1,1\n", "the columns case, visit. The columns case and patient"),
        ("case,patient\nP04_v1,1\n", r"no row of 6 of the 7 cases: P04_v2, P05_left"),
        ("case,patient\nP04_v1,1\nP04_v1,2\n", "two rows of the case P04_v1"),
        ("case,patient\nP04_v1,1\nP04_v2,\n", r"row 3 of .* has no patient"),
    ],
)
def test_tables_that_do_not_fit_are_refused(tmp_path: Path, content: str, message: str) -> None:
    (tmp_path / "p.csv").write_text(content)
    data = MaskFolderData(folder=masks(tmp_path / "m"), patients=tmp_path / "p.csv")
    with pytest.raises(StudyError, match=message):
        data.find(Path())


def test_a_side_that_contradicts_the_id_is_refused(tmp_path: Path) -> None:
    rows = "".join(f"{name},{name},right\n" for name in IDS)
    (tmp_path / "p.csv").write_text("case,patient,side\n" + rows)
    data = MaskFolderData(folder=masks(tmp_path / "m"), patients=tmp_path / "p.csv")
    with pytest.raises(StudyError, match="P05_left says left and the table says right"):
        data.find(Path())


def test_every_source_of_files_knows_the_table() -> None:
    for kind in (Luna16Data, MaskFolderData, MeshFolderData):
        assert kind(patients=Path("p.csv")).patients == Path("p.csv")
        # The table says which cases belong together; no case's mesh depends on it.
        assert kind(patients=Path("p.csv")).case_settings() == kind().case_settings()


def test_ids_that_look_like_pairs_are_named_unless_the_patients_are_known() -> None:
    own = {name: name for name in IDS}
    assert list(likely_patients(own)) == ["P04", "P05", "P06"]
    said = advice_on_patients(own)
    assert "3 patients seem to have several cases (P04_v1 and P04_v2)" in said
    assert "data.patients" in said
    known = {name: name[:3] for name in IDS}
    assert likely_patients(known) == {}
    assert advice_on_patients(known) == ""
    assert likely_patients({name: name for name in ("lung_1", "lung_2", "t1", "v2")}) == {}

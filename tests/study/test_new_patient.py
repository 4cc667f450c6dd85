"""A new patient's file: which part of it is the organ."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk

from ssm_pipeline.records import CaseError, Mask, StudyError
from ssm_pipeline.study.new_patient import HowToRead, read_patient
from ssm_pipeline.study.sources import MaskFolderData


@pytest.fixture
def two_labels(tmp_path: Path) -> Path:
    """600 voxels of label 1, 200 of label 3."""
    labels = np.zeros((20, 20, 20), np.uint8)
    labels[3:9, 5:15, 5:15], labels[12:14, 5:15, 5:15] = 1, 3
    path = tmp_path / "new.nii.gz"
    sitk.WriteImage(sitk.GetImageFromArray(labels), str(path))
    return path


def voxels(path: Path, data: MaskFolderData, how: HowToRead) -> int:
    mask = read_patient(path, data, how)
    assert isinstance(mask, Mask)
    return int(mask.voxels.sum())


def test_a_label_counts_where_the_study_has_a_threshold(two_labels: Path) -> None:
    data = MaskFolderData(folder=two_labels.parent, threshold=0.5)
    assert voxels(two_labels, data, HowToRead(labels=(3,))) == 200
    with pytest.raises(CaseError, match="label 77"):
        read_patient(two_labels, data, HowToRead(labels=(77,)))


def test_a_study_on_segments_asks_which_label_of_a_plain_image(two_labels: Path) -> None:
    data = MaskFolderData(folder=two_labels.parent, segments=("liver",))
    with pytest.raises(
        StudyError, match=r"segments liver, but new\.nii\.gz has no named segments.*--label"
    ):
        read_patient(two_labels, data)
    assert voxels(two_labels, data, HowToRead(labels=(3,))) == 200

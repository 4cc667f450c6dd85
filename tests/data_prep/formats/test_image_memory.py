"""A mask that needs more memory than there is, is refused by its header, before it is read."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import psutil
import pytest
import SimpleITK as sitk

from ssm_pipeline.data_prep.formats.image_memory import needed_gb
from ssm_pipeline.data_prep.formats.images import read_organ
from ssm_pipeline.engine.memory import memory_capped
from ssm_pipeline.records import StudyError


def write(path: Path, size: int, kind: str = "uint8") -> Path:
    voxels = np.zeros((size,) * 3, kind)
    voxels[10:40, 10:40, 10:40] = 1
    sitk.WriteImage(sitk.GetImageFromArray(voxels), str(path))
    return path


def test_what_a_mask_needs_grows_with_its_voxels_and_their_type(tmp_path: Path) -> None:
    small, large = write(tmp_path / "a.nii.gz", 50), write(tmp_path / "b.nii.gz", 100)
    wide = write(tmp_path / "c.mhd", 50, "float64")
    assert needed_gb(large) == pytest.approx(8 * needed_gb(small))
    assert needed_gb(small) == pytest.approx(50**3 * 10 / 2**30)
    assert needed_gb(wide) == pytest.approx(50**3 * 24 / 2**30)


def test_a_mask_of_terabytes_is_not_read(tmp_path: Path) -> None:
    path = write(tmp_path / "giant.mhd", 50)
    path.write_text(path.read_text().replace("DimSize = 50 50 50", "DimSize = 8000 8000 8000"))
    os.truncate(tmp_path / "giant.raw", 8000**3)  # a sparse file: it takes no room
    with pytest.raises(StudyError, match=r"case giant: giant\.mhd is large: .*4768\.4 GB, and"):
        read_organ(path, (1,), "giant")


@pytest.mark.skipif(not hasattr(psutil, "RLIMIT_DATA"), reason="the system knows no such limit")
def test_what_a_process_may_have_is_what_counts(tmp_path: Path) -> None:
    path = write(tmp_path / "a.nii.gz", 300)  # 0.25 GB
    assert read_organ(path, (1,), "a").voxels.any()
    holds_gb = psutil.Process().memory_info().data / 2**30
    with memory_capped(holds_gb + 0.1):
        with pytest.raises(StudyError, match=r"takes up to 0\.3 GB, and 0\.1 GB are free"):
            read_organ(path, (1,), "a")
    assert read_organ(path, (1,), "a").voxels.any()  # the limit is gone with the block

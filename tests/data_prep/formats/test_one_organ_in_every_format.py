"""The same organ as mask, as STL in metres, as .seg.nrrd and as DICOM SEG: the same mesh."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import trimesh
from loading import loaded_mask
from seg_files import write_dicom_seg, write_seg_nrrd

from ssm_pipeline.data_prep.cohorts import luna16
from ssm_pipeline.data_prep.cohorts.mask_folder import Organ
from ssm_pipeline.data_prep.cohorts.mask_folder import find_cases as find_masks
from ssm_pipeline.data_prep.cohorts.surface_folder import find_cases as find_surfaces
from ssm_pipeline.geometry.distances import SurfaceTarget, surface_distance
from ssm_pipeline.meshing.quick_mesh import quick_mesh
from ssm_pipeline.meshing.settings import MeshingSettings
from ssm_pipeline.records import Mask, Mesh

REAL = Path(__file__).parents[4] / "shared" / "data" / "luna16"
SETTINGS = MeshingSettings()


def bean() -> Mask:
    """A bent body of 60 mm, left-right different, on a grid turned out of the axes."""
    z, y, x = (np.indices((30, 44, 44)) - np.array([15, 22, 22]).reshape(3, 1, 1, 1)) * 1.0
    inside = (x / 15 + 0.02 * y**2 / 9) ** 2 + (y / 18) ** 2 + (z / 11 + 0.01 * x) ** 2 < 1
    c, s = np.cos(0.3), np.sin(0.3)
    direction = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return Mask(inside, np.array([1.4, 1.4, 2.0]), np.array([-40.0, 10, 300]), direction, "bean")


def cropped(mask: Mask) -> Mask:
    """With a margin of two voxels: DICOM SEG of a whole chest takes its time."""
    used = np.argwhere(mask.voxels)
    low, high = used.min(axis=0) - 2, used.max(axis=0) + 3
    low = np.maximum(low, 0)
    voxels = mask.voxels[low[0] : high[0], low[1] : high[1], low[2] : high[2]]
    return dataclasses.replace(mask, voxels=voxels, origin_mm=mask.to_world(low[::-1] * 1.0))


def apart_mm(one: Mesh, other: Mesh) -> float:
    targets = [SurfaceTarget.of(mesh.vertices, mesh.faces) for mesh in (one, other)]
    return surface_distance(*targets).hd95


def check(mask: Mask, folder: Path, surface_mm: float) -> None:
    mesh, _ = quick_mesh(mask, SETTINGS)
    other = np.zeros_like(mask.voxels)
    other[:3, :3, :3] = True
    segments = {"other": other, "organ": mask.voxels}
    for name in ("nrrd", "dicom", "stl"):
        (folder / name).mkdir()
    write_seg_nrrd(folder / "nrrd" / "a.seg.nrrd", mask, segments)
    write_dicom_seg(folder / "dicom" / "a.dcm", mask, segments)
    for kind in ("nrrd", "dicom"):
        (case,) = find_masks(folder / kind, Organ(segments=("organ",))).cases
        found, _ = quick_mesh(case.load(), SETTINGS)
        # Voxel for voxel the same, but for the last digits of the header: from those on,
        # reduction chooses other triangles.
        assert apart_mm(found, mesh) < surface_mm
    trimesh.Trimesh(mesh.vertices / 1000, mesh.faces).export(folder / "stl" / "a.stl")
    (case,) = find_surfaces(folder / "stl", unit="m").cases
    found, quality = quick_mesh(case.load(), SETTINGS)
    assert apart_mm(found, mesh) < surface_mm
    assert quality.volume_change_percent == pytest.approx(0, abs=0.01)


def test_a_bean(tmp_path: Path) -> None:
    check(bean(), tmp_path, surface_mm=0.3)  # triangles of 3 mm


@pytest.mark.skipif(not REAL.is_dir(), reason="../shared/data/luna16 is not here")
@pytest.mark.parametrize("number", [pytest.param(1, marks=pytest.mark.slow), 20])
def test_left_lungs(tmp_path: Path, number: int) -> None:
    mask = cropped(loaded_mask(luna16.find_cases(REAL).cases[number]))
    check(mask, tmp_path, surface_mm=1.0)  # triangles of 12 mm, cut anew

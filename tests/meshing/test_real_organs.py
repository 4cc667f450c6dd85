"""Real lungs and hippocampi: closed, genus 0, true to the mask. Skipped where the data are not."""

from pathlib import Path

import pytest
from loading import loaded_mask

from ssm_pipeline.data_prep.cohorts import luna16, mask_folder
from ssm_pipeline.geometry.topology import is_oriented_manifold
from ssm_pipeline.meshing.mask_to_mesh import mesh_with_quality
from ssm_pipeline.meshing.settings import MeshingSettings

DATA = Path(__file__).parents[3] / "shared" / "data"
pytestmark = pytest.mark.skipif(
    not DATA.is_dir(), reason="the real masks (../shared/data) are not here"
)


@pytest.mark.parametrize(
    ("number", "handles"),
    [(1, 1), (20, 0)],  # a handle at the hilum that the blur leaves; none
)
def test_left_lungs(number: int, handles: int) -> None:
    case = luna16.find_cases(DATA / "luna16").cases[number]
    mesh, quality = mesh_with_quality(loaded_mask(case), MeshingSettings())
    assert is_oriented_manifold(mesh.faces)
    assert (quality.euler_number, quality.boundary_loops) == (2, 0)
    assert quality.handles_cut == handles
    assert 7900 <= quality.faces <= 8000
    assert quality.volume_change_percent == pytest.approx(0, abs=0.05)
    assert quality.min_angle_deg > 5
    assert quality.surface_hd95_mm < 1.5  # slices are 1 and 2.5 mm thick, the blur 2 mm


@pytest.mark.parametrize("number", [0, 16, 59])
def test_hippocampi(number: int) -> None:
    folder = DATA / "msd_hippocampus" / "labelsTr"
    cohort = mask_folder.find_cases(folder, mask_folder.Organ((1, 2)))
    mesh, quality = mesh_with_quality(
        loaded_mask(cohort.cases[number]), MeshingSettings(faces=4000)
    )
    assert is_oriented_manifold(mesh.faces)
    assert quality.euler_number == 2
    assert quality.volume_change_percent == pytest.approx(0, abs=0.05)
    assert quality.surface_hd95_mm < 0.6  # of 1 mm voxels

"""Seconds and peak memory of each step from a 512 × 512 × 300 mask to 8000 triangles.

    python benchmarks/bench_meshing.py [mask.mhd --label 3]

Without a file a phantom lung is voxelised to that size. Prints one table of the steps as
the pipeline runs them, then what each choice saves over the plain way of doing the same.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

import numpy as np
import SimpleITK as sitk
from scipy import ndimage
from skimage.measure import marching_cubes

from ssm_pipeline.data_prep.formats.images import read_organ
from ssm_pipeline.data_prep.synthetic.phantom_settings import PhantomSettings
from ssm_pipeline.data_prep.synthetic.smooth_phantoms import draw, voxelise
from ssm_pipeline.geometry.topology import euler_number, min_angle_deg
from ssm_pipeline.meshing.decimation import decimate, reduce_fast
from ssm_pipeline.meshing.handles import cut_handles
from ssm_pipeline.meshing.isosurface import isosurface
from ssm_pipeline.meshing.mask_to_mesh import grid_sizes, mesh_with_quality
from ssm_pipeline.meshing.organ import keep_organ
from ssm_pipeline.meshing.quality import measure_quality
from ssm_pipeline.meshing.settings import MeshingSettings
from ssm_pipeline.meshing.smooth_field import smooth_field
from ssm_pipeline.meshing.smoothing import laplacian_smoothing, restore_volume
from ssm_pipeline.records import Mesh

Result = TypeVar("Result")
SHAPE = (300, 512, 512)  # z, y, x


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mask", nargs="?", type=Path)
    parser.add_argument("--label", type=int, default=3)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = arguments.mask
        if path is None:
            # In a process of its own, whose memory does not count as meshing's.
            with ProcessPoolExecutor(1, get_context("spawn")) as pool:
                path = pool.submit(write_phantom, Path(folder) / "phantom.mhd").result()
        run(path, arguments.label)


def write_phantom(path: Path) -> Path:
    """One phantom lung in a full-size chest CT grid."""
    truth, _ = draw(PhantomSettings(cases=2))
    cropped = sitk.GetArrayFromImage(voxelise({3: (truth.vertices[0], truth.faces)}, (0.7, 0.7, 1)))
    lower = [(full - part) // 2 for full, part in zip(SHAPE, cropped.shape, strict=True)]
    upper = [f - p - low for f, p, low in zip(SHAPE, cropped.shape, lower, strict=True)]
    image = sitk.GetImageFromArray(np.pad(cropped, list(zip(lower, upper, strict=True))))
    image.SetSpacing((0.7, 0.7, 1.0))
    sitk.WriteImage(image, str(path), useCompression=True)
    return path


def run(path: Path, label: int) -> None:
    settings = MeshingSettings()
    print(f"{'step':<34}{'wall s':>8}{'cpu s':>8}{'peak MiB':>10}")
    print(f"{'(before)':<34}{'':>16}{peak_mib():>10.0f}")
    mask = timed("read", lambda: read_organ(path, (label,), "bench"))
    print(f"  {mask.voxels.shape[::-1]} voxels")
    mesh, quality = timed(
        "the whole of mesh_with_quality", lambda: mesh_with_quality(mask, settings)
    )

    print("its parts")
    organ, cleaning = timed("  largest piece, cavities", lambda: keep_organ(mask))
    sizes = grid_sizes(organ.volume_mm3, settings)
    field = timed("  blur and resample", lambda: smooth_field(organ, *sizes))
    surface = timed("  surface (VTK)", lambda: isosurface(field, "bench"))
    smooth = timed(
        "  Laplacian smoothing",
        lambda: laplacian_smoothing(surface.vertices, surface.faces, settings.laplacian_steps),
    )
    full = Mesh(restore_volume(smooth, surface.faces, organ.volume_mm3), surface.faces, "bench")
    reduced = timed("  fast-simplification", lambda: reduce_fast(full, settings.fast_faces))
    timed("  handles", lambda: cut_handles(reduced))
    timed("  decimation (MeshLab), spreading", lambda: decimate(reduced, settings.faces))
    timed("  quality", lambda: measure_quality(mesh, organ, cleaning, 0, *sizes))

    print("the plain way")
    sigma_voxels = [sizes[1] / step for step in organ.spacing_mm[::-1]]
    zoom = [step / sizes[0] for step in organ.spacing_mm[::-1]]
    timed(
        "  blur (scipy, full grid), zoom",
        lambda: ndimage.zoom(
            ndimage.gaussian_filter(np.pad(organ.voxels, 12).astype(np.float32), sigma_voxels),
            zoom,
            order=1,
        ),
    )
    timed("  surface (scikit-image)", lambda: marching_cubes(field.values, field.level))
    direct = timed(
        "  decimation (MeshLab alone)",
        lambda: decimate(full, settings.faces, fast_faces=len(full.faces)),
    )
    print(
        f"mesh: {quality.faces} triangles, Euler number {quality.euler_number} "
        f"({euler_number(surface.faces)} before cutting), smallest angle "
        f"{quality.min_angle_deg:.1f}° (MeshLab alone "
        f"{min_angle_deg(direct.vertices, direct.faces):.1f}°), volume change "
        f"{quality.volume_change_percent:+.4f} %, surface to mask {quality.surface_mean_mm:.2f} mm "
        f"(HD95 {quality.surface_hd95_mm:.2f} mm)"
    )


def timed(name: str, work: Callable[[], Result]) -> Result:
    wall, cpu = time.perf_counter(), time.process_time()
    result = work()
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    print(f"{name:<34}{wall:>8.2f}{cpu:>8.2f}{peak_mib():>10.0f}", flush=True)
    return result


def peak_mib() -> float:
    """The process's largest resident memory so far (kibibytes on Linux)."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


if __name__ == "__main__":
    main()

"""`workflow doctor`: describe this machine for a bug report, and check what a run needs."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from ssm_pipeline.engine import process

# Run in a separate process: without its libraries, VTK crashes the process it draws in.
DRAW = (
    "import pyvista; p = pyvista.Plotter(off_screen=True, window_size=(64, 64)); "
    "p.add_mesh(pyvista.Sphere()); image = p.screenshot(return_img=True); "
    "assert image.min() != image.max(), 'the picture is empty'"
)
DECIMATE = (
    "import pymeshlab; "
    "assert hasattr(pymeshlab.MeshSet(), 'meshing_decimation_quadric_edge_collapse')"
)
LEAST_FREE_GB = 5.0


def diagnosis(runs: Path) -> tuple[list[str], bool]:
    """Return lines to print, and whether this machine can run a study."""
    lines = [f"{name:<21}{version}" for name, version in process.versions().items()]
    lines += [f"{name:<21}{value}" for name, value in process.machine().items()]
    lines.append(f"{'jobs':<21}{process.default_jobs()} at a time, by default")
    lines.append(f"{'gpu':<21}{_gpu()}")
    free_gb = shutil.disk_usage(_nearest_folder(runs)).free / 2**30
    checks = [
        ("disk", free_gb >= LEAST_FREE_GB, f"{free_gb:.0f} GB free for {runs}", "free some space"),
        (
            "writing",
            os.access(_nearest_folder(runs), os.W_OK),
            f"{_nearest_folder(runs)}",
            "choose another folder with --runs",
        ),
        ("meshing", *_tried(DECIMATE, "libgl1 libopengl0")),
        ("pictures", *_tried(DRAW, "libegl1 libosmesa6")),
    ]
    for name, is_well, found, advice in checks:
        lines.append(f"{name:<21}{found}" + ("" if is_well else f"   NOT WELL: {advice}"))
    return lines, all(is_well for _, is_well, _, _ in checks)


def _tried(code: str, packages: str) -> tuple[bool, str, str]:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    if done.returncode == 0:
        return True, "works", ""
    said = (done.stderr.strip().splitlines() or [f"ended with code {done.returncode}"])[-1]
    return False, said[:120], f"on Debian and Ubuntu: apt-get install {packages}"


def _gpu() -> str:
    import torch

    if not torch.cuda.is_available():
        return "none that PyTorch can use; training runs on the CPU"
    properties = torch.cuda.get_device_properties(0)
    return f"{properties.name}, {properties.total_memory / 2**30:.0f} GB"


def _nearest_folder(path: Path) -> Path:
    path = path.resolve()
    return next(folder for folder in (path, *path.parents) if folder.is_dir())

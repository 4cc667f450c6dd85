"""How much memory a mask takes until it is a mesh: known from its header, before it is read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import psutil
import SimpleITK as sitk

from ssm_pipeline.records import StudyError

# SimpleITK's image and NumPy's copy of it; beside them masks of a byte a voxel, whose pieces are
# numbered. About what was measured on organs that fill their image.
COPIES, MORE_BYTES = 2, 8


def needed_gb(path: Path) -> float:
    """To read an image and mesh an organ that fills it.

    Raises:
        RuntimeError: For no image.
    """
    header = sitk.ImageFileReader()
    header.SetFileName(str(path))
    header.ReadImageInformation()
    stored = sitk.Image([1, 1], header.GetPixelIDValue()).GetSizeOfPixelComponent()
    return needed_gb_of(header.GetSize(), stored * header.GetNumberOfComponents())


def needed_gb_of(size: Sequence[int], stored_bytes: int) -> float:
    """The same, by the number of voxels along each axis and the bytes of one."""
    return math.prod(size) * (COPIES * stored_bytes + MORE_BYTES) / 2**30


def free_gb() -> float:
    """What this process can still take: of the machine's memory, and of what it is allowed."""
    free = psutil.virtual_memory().available
    if hasattr(psutil, "RLIMIT_DATA"):
        this = psutil.Process()
        allowed = this.rlimit(psutil.RLIMIT_DATA)[0]
        if allowed != psutil.RLIM_INFINITY:
            free = min(free, max(allowed - this.memory_info().data, 0))
    result: float = free / 2**30
    return result


def refuse_too_large(needed: float, path: Path, case_id: str) -> None:
    """Raise StudyError for an image that needs more memory (GB) than there is.

    No CaseError, which would drop the case for good: another machine may have the memory.
    """
    free = free_gb()
    if needed > free:
        raise StudyError(
            f"case {case_id}: {path.name} is large: to read and mesh it takes up to {needed:.1f} "
            f"GB, and {free:.1f} GB are free. Run fewer cases at a time (--jobs), let a process "
            "have more (--memory-gb), crop the image, or leave the case out (data.exclude)."
        )

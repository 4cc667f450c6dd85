"""MetaImage headers that ITK must not see: they end the process, or keep it for good.

Measured with SimpleITK 2.5: `NDims = -1` is a segmentation fault, a direction of 1e308 is never
finished with, and a size of 99999 × 99999 × 99999 asks for all memory there is.
"""

from __future__ import annotations

import math
from pathlib import Path

from ssm_pipeline.records import CaseError

BYTES = {
    "MET_CHAR": 1,
    "MET_UCHAR": 1,
    "MET_SHORT": 2,
    "MET_USHORT": 2,
    "MET_INT": 4,
    "MET_UINT": 4,
    "MET_LONG": 4,  # MetaIO's own sizes, on every system
    "MET_ULONG": 4,
    "MET_LONG_LONG": 8,
    "MET_ULONG_LONG": 8,
    "MET_FLOAT": 4,
    "MET_DOUBLE": 8,
}
MOST_COMPRESSION = 1032  # deflate can't do better
# Numbers a field, in dimensions D; all that are present must be finite.
LENGTHS = {
    "TransformMatrix": 9,
    "Orientation": 9,
    "Rotation": 9,
    "Offset": 3,
    "Origin": 3,
    "Position": 3,
    "CenterOfRotation": 3,
    "ElementSpacing": 3,
    "ElementSize": 3,
}
LARGEST = 1e9  # of any such number: a kilometre in micrometres


def check_metaimage(fields: dict[str, str], data_bytes: int, path: Path, case_id: str) -> None:
    """Raise CaseError unless the fields describe one 3D volume that the data can hold.

    Args:
        data_bytes: Length of the voxel data as they lie on the disk.
    """

    def refuse(found: str, needed: str) -> CaseError:
        return CaseError(
            case_id,
            f"the header of {path.name} gives {found}; {needed} needed. "
            "Correct the header, or export the mask again.",
        )

    if fields.get("NDims") != "3":
        raise refuse(f"NDims = {fields.get('NDims', '(nothing)')[:40]}", "one 3D volume is")
    channels = fields.get("ElementNumberOfChannels", "1")
    if channels != "1":
        raise refuse(f"{channels[:40]} values a voxel", "one label a voxel is")
    element = fields.get("ElementType", "(nothing)")
    if element not in BYTES:
        raise refuse(f"ElementType = {element[:40]}", f"one of {', '.join(BYTES)} is")
    for name, length in LENGTHS.items():
        if name in fields:
            values = _numbers(fields[name])
            if len(values) != length or not all(abs(value) < LARGEST for value in values):
                raise refuse(f"{name} = {fields[name][:80]}", f"{length} finite numbers are")
    sizes = fields.get("DimSize", "").split()
    if len(sizes) != 3 or not all(size.isdecimal() and 0 < int(size) < 2**31 for size in sizes):
        raise refuse(f"DimSize = {' '.join(sizes)[:80]}", "three whole numbers are")
    needed = math.prod(map(int, sizes)) * BYTES[element]
    compressed = fields.get("CompressedData", "False").lower() in ("true", "1")
    if needed > data_bytes * (MOST_COMPRESSION if compressed else 1):
        raise CaseError(
            case_id,
            f"{path.name} is damaged or cut short: its header promises {needed} bytes of voxels, "
            f"and there are {data_bytes}. Copy or download it again.",
        )


def _numbers(text: str) -> list[float]:
    """The numbers in a field's text; none where one of its words is no finite number."""
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        return []
    return values if all(map(math.isfinite, values)) else []

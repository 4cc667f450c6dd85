"""What a NIfTI-1 header says: is the file whole, and where does its image lie?

Measured with SimpleITK 2.5: a file cut short is filled up with zeros in silence; a negative
`pixdim` makes it drop a valid sform, and the organ comes out mirrored.
"""

from __future__ import annotations

import gzip
import math
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ssm_pipeline.records import CaseError

_BYTES = 348
_CHUNK = 1 << 22
_UNITS_MM = {1: 1000.0, 3: 1e-3}  # xyzt_units: metres, micrometres; else millimetres
RAS_TO_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])


@dataclass(frozen=True, eq=False)
class NiftiHeader:
    """dim (8,), pixdim (8,), bits a voxel, vox_offset and the two transforms as stored (RAS).

    quaternion  (6,): b, c, d, and the offsets x, y, z of the qform.
    srow        (3, 4): the sform.
    unit_mm     of all lengths.
    """

    dim: tuple[int, ...]
    pixdim: tuple[float, ...]
    bits: int
    vox_offset: float
    qform_code: int
    sform_code: int
    quaternion: tuple[float, ...]
    srow: np.ndarray
    unit_mm: float = 1.0

    @property
    def needed_bytes(self) -> float:
        return self.vox_offset + math.prod(self.dim[1 : 1 + self.dim[0]]) * self.bits / 8

    @property
    def misleads_itk(self) -> bool:
        """True where SimpleITK may place the image otherwise than the standard says."""
        return any(size < 0 for size in self.pixdim[1:4]) or (
            self.qform_code <= 0 < self.sform_code
        )

    def affine_lps(self) -> np.ndarray:
        """(4, 4): voxel index x, y, z → mm LPS, by sform, else qform, else voxel sizes alone."""
        affine = np.eye(4)
        sizes = np.abs(self.pixdim[1:4])  # a sign has no meaning here: directions are the forms'
        if self.sform_code > 0:
            affine[:3] = self.srow
        elif self.qform_code > 0:
            b, c, d = self.quaternion[:3]
            a = math.sqrt(max(0.0, 1 - b * b - c * c - d * d))
            rotation = np.array(
                [
                    [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
                    [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
                    [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - c * c - b * b],
                ]
            )
            handed = np.array([1.0, 1.0, -1.0 if self.pixdim[0] < 0 else 1.0])
            affine[:3, :3] = rotation * (sizes * handed)
            affine[:3, 3] = self.quaternion[3:]
        else:
            affine[:3, :3] = np.diag(sizes)
        affine[:3] *= self.unit_mm
        return RAS_TO_LPS @ affine


def read_nifti_header(path: Path, case_id: str) -> tuple[NiftiHeader | None, int]:
    """The header and the number of bytes in the file, decompressed to its end.

    None for NIfTI-2 and Analyze, which are left to SimpleITK. Raises CaseError for a damaged file.
    """
    compressed = path.name.lower().endswith(".gz")
    try:
        with gzip.open(path, "rb") if compressed else path.open("rb") as file:
            header = file.read(_BYTES)
            if len(header) < _BYTES:
                raise damaged(path, case_id, "it ends inside its header")
            found = len(header)
            while block := file.read(_CHUNK):
                found += len(block)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise damaged(path, case_id, str(error)) from error
    order = "<" if struct.unpack_from("<i", header)[0] == _BYTES else ">"
    if struct.unpack_from(order + "i", header)[0] != _BYTES:
        return None, found
    qform_code, sform_code = struct.unpack_from(order + "2h", header, 252)
    return (
        NiftiHeader(
            dim=struct.unpack_from(order + "8h", header, 40),
            pixdim=struct.unpack_from(order + "8f", header, 76),
            bits=struct.unpack_from(order + "h", header, 72)[0],
            vox_offset=struct.unpack_from(order + "f", header, 108)[0],
            qform_code=qform_code,
            sform_code=sform_code,
            quaternion=struct.unpack_from(order + "6f", header, 256),
            srow=np.array(struct.unpack_from(order + "12f", header, 280)).reshape(3, 4),
            unit_mm=_UNITS_MM.get(header[123] & 7, 1.0),
        ),
        found,
    )


def check_nifti_size(header: NiftiHeader, found: int, path: Path, case_id: str) -> None:
    """Raise CaseError where the header's sizes make no sense, or promise more than there is."""
    axes = header.dim[0]
    sizes = header.dim[1 : 1 + max(axes, 0)]
    if not 1 <= axes <= 7 or min(sizes) < 1 or header.bits < 1:
        raise damaged(
            path, case_id, f"its header gives dimensions {header.dim}, {header.bits} bits a voxel"
        )
    if not (math.isfinite(header.vox_offset) and header.vox_offset >= 0):
        raise damaged(path, case_id, f"its header puts the voxels at byte {header.vox_offset:g}")
    if found < header.needed_bytes:
        promised = f"its header promises {header.needed_bytes:.0f}"
        raise damaged(path, case_id, f"it holds {found} bytes and {promised}")


def damaged(path: Path, case_id: str, what: str) -> CaseError:
    """The error for a file that is not whole."""
    return CaseError(
        case_id,
        f"{path.name} is damaged or cut short ({what}); the whole file is needed. "
        "Copy or download it again.",
    )

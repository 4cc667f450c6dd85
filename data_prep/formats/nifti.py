"""NIfTI files (1 and 2), by nibabel: is the file whole, and where does its image lie?

SimpleITK reads most of them. Measured with SimpleITK 2.5, it fills a file that is cut short with
zeros, drops a valid sform beside a negative `pixdim`, places by the qform where both forms exist,
and refuses a sform whose axes are slightly skewed and a compression that the name does not tell.
Such files are read here.
"""

from __future__ import annotations

import gzip
import math
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import nibabel
import numpy as np

from ssm_pipeline.data_prep.formats.damaged import damaged
from ssm_pipeline.records import CaseError

_BYTES = {348: nibabel.Nifti1Header, 540: nibabel.Nifti2Header}
_CHUNK = 1 << 22
_UNITS_MM = {1: 1000.0, 3: 1e-3}  # xyzt_units: metres, micrometres; else millimetres
RAS_TO_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])
SAME_PLACE = 0.01  # of the smallest voxel: float32 headers differ by less
SAME_SIZE = 0.01  # of a voxel's edge


@dataclass(frozen=True, eq=False)
class NiftiFile:
    """The header of a NIfTI file that is whole.

    Attributes:
        header: As nibabel reads it, with positive voxel sizes: directions are the forms' alone.
        is_compressed: Whether the content is compressed, whatever the name says.
        has_negative_sizes: Whether the file gave a voxel size with a sign.
    """

    path: Path
    case_id: str
    header: Any
    is_compressed: bool
    has_negative_sizes: bool

    @property
    def misleads_itk(self) -> bool:
        """Whether SimpleITK may refuse the image, or place it differently. Raises CaseError."""
        named_compressed = self.path.name.lower().endswith(".gz")
        return (
            named_compressed != self.is_compressed
            or self.has_negative_sizes
            or int(self.header["qform_code"]) <= 0 < int(self.header["sform_code"])
            or self._voxels_apart() > SAME_PLACE
        )

    @property
    def unit_mm(self) -> float:
        """The unit of lengths that the header states, in mm; SimpleITK applies it too."""
        return _UNITS_MM.get(int(self.header["xyzt_units"]) & 7, 1.0)

    def affine_lps(self) -> np.ndarray:
        """(4, 4): voxel index x, y, z → mm LPS, by sform, else qform, else voxel sizes alone."""
        sform, qform = self._forms()
        sizes = np.asarray(self.header["pixdim"][1:4], float)
        affine = next((form for form in (sform, qform) if form is not None), np.diag([*sizes, 1.0]))
        result: np.ndarray = RAS_TO_LPS @ np.diag([self.unit_mm] * 3 + [1.0]) @ affine
        return result

    def _forms(self) -> tuple[np.ndarray | None, np.ndarray | None]:
        """The sform and the qform (4, 4), each None without a positive code. Raises CaseError."""
        try:
            sform, of_sform = self.header.get_sform(coded=True)
            qform, of_qform = self.header.get_qform(coded=True)
        except (ValueError, nibabel.spatialimages.HeaderDataError) as error:
            what = f"its qform is no rotation: {error}"
            raise damaged(self.path, self.case_id, what) from error
        return sform if of_sform > 0 else None, qform if of_qform > 0 else None

    def _voxels_apart(self) -> float:
        """How far apart the two forms put a corner at most, in edges of the smallest voxel."""
        sform, qform = self._forms()
        if sform is None or qform is None:
            return 0.0
        last = np.asarray(self.header["dim"][1:4], float) - 1
        corners = np.stack(np.meshgrid(*([0.0, end] for end in last)), axis=-1).reshape(-1, 3)
        with np.errstate(all="ignore"):  # damaged forms hold any number
            moved = corners @ (sform - qform)[:3, :3].T + (sform - qform)[:3, 3]
            edge = max(float(np.linalg.norm(sform[:3, :3], axis=0).min()), 1e-12)
            apart = float(np.linalg.norm(moved, axis=1).max()) / edge
        return apart if math.isfinite(apart) else math.inf

    def warnings(self) -> tuple[str, ...]:
        """What the two forms say differently about the place.

        Raises:
            CaseError: they differ in size or handedness, and one of them must be wrong.
        """
        sform, qform = self._forms()
        apart = self._voxels_apart()
        if sform is None or qform is None or apart <= SAME_PLACE:
            return ()
        sizes = [np.linalg.norm(form[:3, :3], axis=0) for form in (sform, qform)]
        mirrored = np.linalg.det(sform[:3, :3]) * np.linalg.det(qform[:3, :3]) < 0
        if mirrored or np.abs(sizes[0] / sizes[1] - 1).max() > SAME_SIZE:
            what = "are mirror images of each other" if mirrored else "give different voxel sizes"
            raise CaseError(
                self.case_id,
                f"{self.path.name} contradicts itself: its sform (voxels of {_in_words(sizes[0])} "
                f"mm) and its qform ({_in_words(sizes[1])} mm) {what}. Set the code of the wrong "
                "one to 0, or export the mask again.",
            )
        if apart < 0.5:
            return ()
        return (
            f"the sform and the qform of {self.path.name} put the image up to "
            f"{apart * sizes[0].min():.3g} mm apart; the sform is used",
        )

    def voxels(self) -> np.ndarray:
        """(Z, Y, X), scaled as the header says. Raises CaseError."""
        try:
            with _opened(self.path, self.is_compressed) as file:
                return np.asarray(self.header.data_from_fileobj(file)).T
        except (OSError, ValueError, TypeError, KeyError, nibabel.wrapstruct.WrapStructError) as e:
            raise damaged(self.path, self.case_id, str(e)) from e


def read_nifti_header(path: Path, case_id: str) -> NiftiFile | None:
    """The header of a file, which is decompressed to its end to see that it is whole.

    Returns:
        None for a file that has neither NIfTI header, such as Analyze.

    Raises:
        CaseError: the file is damaged, or its sizes make no sense.
    """
    with path.open("rb") as file:
        is_compressed = file.read(2) == b"\x1f\x8b"
    try:
        with _opened(path, is_compressed) as file:
            content = file.read(max(_BYTES))
            found = len(content)
            while block := file.read(_CHUNK):
                found += len(block)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise damaged(path, case_id, str(error)) from error
    if found < min(_BYTES):
        raise damaged(path, case_id, "it ends inside its header")
    size, order = next(
        (
            (size, order)
            for order in ("little", "big")
            if (size := int.from_bytes(content[:4], order)) in _BYTES
        ),
        (0, ""),
    )
    if not size or found < size:
        return None
    header = _BYTES[size](content[:size], "<" if order == "little" else ">", check=False)  # type: ignore[no-untyped-call]
    _check_size(header, found, path, case_id)
    signed = bool((header["pixdim"][1:4] < 0).any())
    header["pixdim"][1:4] = np.abs(header["pixdim"][1:4])
    header["pixdim"][0] = -1 if header["pixdim"][0] < 0 else 1
    return NiftiFile(path, case_id, header, is_compressed, signed)


def _opened(path: Path, is_compressed: bool) -> IO[bytes]:
    return gzip.open(path, "rb") if is_compressed else path.open("rb")  # type: ignore[return-value]


def _in_words(sizes: np.ndarray) -> str:
    return " × ".join(f"{size:.3g}" for size in sizes)


def _check_size(header: Any, found: int, path: Path, case_id: str) -> None:
    """Raise CaseError where the header's sizes make no sense, or promise more than there is."""
    dim, bits = [int(size) for size in header["dim"]], int(header["bitpix"])
    axes, offset = dim[0], float(header["vox_offset"])
    sizes = dim[1 : 1 + max(axes, 0)]
    if not 1 <= axes <= 7 or min(sizes) < 1 or bits < 1:
        raise damaged(path, case_id, f"its header gives dimensions {dim}, {bits} bits a voxel")
    if not (math.isfinite(offset) and offset >= 0):
        raise damaged(path, case_id, f"its header puts the voxels at byte {offset:g}")
    needed = offset + math.prod(sizes) * bits / 8
    if found < needed:
        raise damaged(path, case_id, f"it holds {found} bytes and its header promises {needed:.0f}")

"""Is an image file whole? SimpleITK reads some damaged files in silence.

Measured with SimpleITK 2.5: a NIfTI file cut short is filled up with zeros, and a `.zraw` with a
damaged byte loses what follows it; neither raises. Cut `.mhd` and `.nrrd` data do raise.
"""

from __future__ import annotations

import gzip
import math
import os
import struct
import zlib
from pathlib import Path

import numpy as np

from data_prep.metaimage_header import check_metaimage
from ssm_pipeline.records import CaseError

SUFFIXES = (".mhd", ".mha", ".nrrd", ".nii.gz", ".nii")
_CHUNK = 1 << 22
_NIFTI_HEADER = 348


def image_suffix(path: Path) -> str | None:
    """The label image suffix of a file name (`.nii.gz` counts as one), or None."""
    return next((suffix for suffix in SUFFIXES if path.name.lower().endswith(suffix)), None)


def image_stem(path: Path) -> str:
    """The file name without its image suffix: dots inside a series UID stay."""
    suffix = image_suffix(path)
    return path.name[: -len(suffix)] if suffix else path.stem


def is_image(path: Path) -> bool:
    """True for label images; False for hidden files such as macOS's `._case.nii.gz`."""
    return image_suffix(path) is not None and not path.name.startswith(".") and path.is_file()


def check_header(path: Path, case_id: str) -> None:
    """Raise CaseError for a header whose spacing is not usable or whose data file is missing.

    A NIfTI file is also decompressed to its end, as SimpleITK would not notice one cut short.
    """
    suffix = image_suffix(path)
    if suffix in (".mhd", ".mha"):
        fields, header_bytes = _metaimage_header(path)
        _check_spacing(fields.get("ElementSpacing", "1").split(), path, case_id)
        name = fields.get("ElementDataFile", "")
        if name.upper() != "LOCAL" and not (path.parent / name).is_file():
            raise CaseError(
                case_id,
                f"{path.name} names the data file {name or '(none)'}, which is not beside it. "
                "Copy the .mhd and its .zraw together.",
            )
        is_local = name.upper() == "LOCAL"
        data_bytes = path.stat().st_size - header_bytes if is_local else 0
        if not is_local:
            data_bytes = (path.parent / name).stat().st_size
        check_metaimage(fields, data_bytes, path, case_id)
    elif suffix in (".nii", ".nii.gz"):
        _check_nifti(path, case_id)


def check_voxels(path: Path, case_id: str, voxels: np.ndarray) -> None:
    """Raise CaseError if `voxels`, as read, are not all of a compressed MetaImage's or NRRD's data.

    A compressed stream ends in a checksum of what it holds, so that the sum of the voxels read
    proves them (0.03 s for 512 × 512 × 300 labels). Where it differs, the data are decompressed
    once more (0.5 s) to say what is wrong, if anything is: other byte orders differ and are fine.
    """
    stream = _compressed_stream(path)
    if stream is None:
        return  # SimpleITK itself refuses raw data of the wrong length
    data_path, start, window_bits = stream
    content = np.ascontiguousarray(voxels).data
    with data_path.open("rb") as file:
        file.seek(-8, os.SEEK_END)
        tail = file.read()
        if window_bits == zlib.MAX_WBITS:  # zlib: Adler-32 last, big-endian
            proven = int.from_bytes(tail[4:], "big") == zlib.adler32(content)
        else:  # gzip: CRC-32 and length last, little-endian
            proven = int.from_bytes(tail[:4], "little") == zlib.crc32(content)
        if proven:
            return
        file.seek(start)
        inflater = zlib.decompressobj(window_bits)
        try:
            while not inflater.eof and (block := file.read(_CHUNK)):
                inflater.decompress(block)
        except zlib.error as error:
            raise damaged(data_path, case_id, str(error)) from error
    if not inflater.eof:
        raise damaged(data_path, case_id, "the compressed data end too early")


def _compressed_stream(path: Path) -> tuple[Path, int, int] | None:
    """File, first byte and zlib's window bits of a MetaImage's or NRRD's compressed voxels."""
    suffix = image_suffix(path)
    if suffix in (".mhd", ".mha"):
        fields, header_bytes = _metaimage_header(path)
        if fields.get("CompressedData", "False").lower() != "true":
            return None
        name = fields.get("ElementDataFile", "")
        if name.upper() == "LOCAL":
            return path, header_bytes, zlib.MAX_WBITS
        return path.parent / name, 0, zlib.MAX_WBITS
    if suffix == ".nrrd":
        compressed = False
        with path.open("rb") as file:
            for line in file:
                if not line.strip():  # a blank line ends the header
                    return (path, file.tell(), 16 + zlib.MAX_WBITS) if compressed else None
                key, _, value = line.decode("latin-1").partition(":")
                compressed |= key == "encoding" and value.strip().lower() in ("gzip", "gz")
    return None


def damaged(path: Path, case_id: str, what: str) -> CaseError:
    """The error for a file that is not whole."""
    return CaseError(
        case_id,
        f"{path.name} is damaged or cut short ({what}); the whole file is needed. "
        "Copy or download it again.",
    )


def _metaimage_header(path: Path) -> tuple[dict[str, str], int]:
    """The header's fields and its length in bytes."""
    fields: dict[str, str] = {}
    with path.open("rb") as file:
        for line in file:
            key, _, value = line.decode("latin-1").partition("=")
            fields.setdefault(key.strip(), value.strip())  # as MetaIO: the first one counts
            if key.strip() == "ElementDataFile":
                break
        return fields, file.tell()


def _check_nifti(path: Path, case_id: str) -> None:
    compressed = image_suffix(path) == ".nii.gz"
    try:
        with gzip.open(path, "rb") if compressed else path.open("rb") as file:
            header = file.read(_NIFTI_HEADER)
            if len(header) < _NIFTI_HEADER:
                raise damaged(path, case_id, "it ends inside its header")
            order = "<" if struct.unpack_from("<i", header)[0] == _NIFTI_HEADER else ">"
            if struct.unpack_from(order + "i", header)[0] != _NIFTI_HEADER:
                return  # NIfTI-2 or Analyze: left to SimpleITK
            dim = struct.unpack_from(order + "8h", header, 40)
            pixdim = struct.unpack_from(order + "8f", header, 76)
            bits = struct.unpack_from(order + "h", header, 72)[0]
            offset = struct.unpack_from(order + "f", header, 108)[0]
            found = _NIFTI_HEADER
            while block := file.read(_CHUNK):
                found += len(block)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise damaged(path, case_id, str(error)) from error
    axes = dim[0]
    _check_spacing([str(value) for value in pixdim[1 : 1 + min(axes, 3)]], path, case_id)
    needed = int(offset) + math.prod(dim[1 : 1 + axes]) * bits // 8
    if found < needed:
        raise damaged(path, case_id, f"it holds {found} bytes and its header promises {needed}")


def _check_spacing(values: list[str], path: Path, case_id: str) -> None:
    try:
        good = all(math.isfinite(float(value)) and float(value) != 0 for value in values)
    except ValueError:
        good = False
    if not good:
        raise CaseError(
            case_id,
            f"the header of {path.name} gives the voxel spacing {' × '.join(values)} mm; finite, "
            "non-zero numbers are needed. Correct the header, or export the mask again.",
        )

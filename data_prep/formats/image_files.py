"""Is an image file whole? SimpleITK reads some damaged files in silence.

Measured with SimpleITK 2.5: a `.zraw` with a damaged byte loses what follows it and does not
raise; cut `.mhd` and `.nrrd` data do raise. What NIfTI hides is in `nifti.py`.
"""

from __future__ import annotations

import math
import os
import zlib
from pathlib import Path

import numpy as np

from ssm_pipeline.data_prep.formats.damaged import damaged
from ssm_pipeline.data_prep.formats.metaimage_header import check_metaimage
from ssm_pipeline.data_prep.formats.nifti import NiftiFile, read_nifti_header
from ssm_pipeline.data_prep.formats.organ_size import Unit
from ssm_pipeline.records import CaseError

SUFFIXES = (".mhd", ".mha", ".seg.nrrd", ".nrrd", ".nii.gz", ".nii")
_CHUNK = 1 << 22
_UNITS: dict[str, Unit] = {
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), "mm"),
    **dict.fromkeys(("um", "\xb5m", "micron", "microns", "micrometer", "micrometers"), "um"),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres"), "cm"),
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), "m"),
}


def image_suffix(path: Path) -> str | None:
    """The label image suffix of a file name (`.nii.gz` counts as one), or None."""
    return next((suffix for suffix in SUFFIXES if path.name.lower().endswith(suffix)), None)


def image_stem(path: Path) -> str:
    """The file name without its image suffix: dots inside a series UID stay."""
    suffix = image_suffix(path)
    return path.name[: -len(suffix)] if suffix else path.name.removesuffix(".dcm")


def is_image(path: Path) -> bool:
    """True for label images; False for hidden files such as macOS's `._case.nii.gz`.

    A link to a file that does not exist counts too, so that the case is reported as left out.
    """
    is_hidden = path.name.startswith(".")
    return image_suffix(path) is not None and not is_hidden and is_file_or_link(path)


def is_file_or_link(path: Path) -> bool:
    """True for a file, and for a link to a file that does not exist."""
    return path.is_file() or is_dangling(path)


def is_dangling(path: Path) -> bool:
    """True for a link to a file that does not exist."""
    return path.is_symlink() and not path.exists()


def check_header(path: Path, case_id: str) -> NiftiFile | None:
    """Raise CaseError for a header whose spacing is not usable or whose data file is missing.

    A NIfTI file is also decompressed to its end, as SimpleITK would not notice one cut short.

    Returns:
        Its header, whose transforms SimpleITK does not always follow; None for other formats.
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
        if (stream := _compressed_stream(path)) is not None:
            _check_zlib_start(stream[0], stream[1], case_id)
    elif suffix in (".nii", ".nii.gz"):
        file = read_nifti_header(path, case_id)
        if file is not None:
            axes = min(int(file.header["dim"][0]), 3)
            _check_spacing(
                [str(size) for size in file.header["pixdim"][1 : 1 + axes]], path, case_id
            )
        return file
    return None


def check_voxels(path: Path, case_id: str, voxels: np.ndarray) -> None:
    """Raise CaseError if `voxels`, as read, are not all of a compressed MetaImage's or NRRD's data.

    A compressed stream ends in a checksum of what it holds, so that the sum of the voxels read
    proves them. Where it differs, the data are decompressed once more to say what is wrong, if
    anything is: other byte orders differ and are fine.
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


def stated_unit(path: Path) -> Unit | None:
    """The unit of lengths that a NRRD or MetaImage header states; SimpleITK does not read it."""
    suffix = image_suffix(path)
    if suffix in (".mhd", ".mha"):
        text = _metaimage_header(path)[0].get("DistanceUnits", "")
    elif suffix in (".nrrd", ".seg.nrrd"):
        text = _nrrd_header(path)[0].get("space units", "")
    else:
        return None
    words = {_UNITS.get(word.strip('"').lower()) for word in text.split()}
    return words.pop() if len(words) == 1 else None


def _check_zlib_start(path: Path, start: int, case_id: str) -> None:
    """Refuse what asks for a dictionary: MetaIO asks zlib to go on, for ever."""
    with path.open("rb") as file:
        file.seek(start)
        first = file.read(2)
    if len(first) < 2 or first[1] & 0x20 or int.from_bytes(first, "big") % 31:
        raise damaged(path, case_id, "the compressed data don't begin as zlib's do")


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
    if suffix in (".nrrd", ".seg.nrrd"):
        fields, header_bytes = _nrrd_header(path)
        if fields.get("encoding", "").lower() in ("gzip", "gz"):
            return path, header_bytes, 16 + zlib.MAX_WBITS
    return None


def _nrrd_header(path: Path) -> tuple[dict[str, str], int]:
    """The header's fields and its length in bytes."""
    fields: dict[str, str] = {}
    with path.open("rb") as file:
        for line in file:
            if not line.strip():  # a blank line ends the header
                break
            key, _, value = line.decode("latin-1").partition(":")
            fields[key.strip().lower()] = value.strip()
        return fields, file.tell()


def _metaimage_header(path: Path) -> tuple[dict[str, str], int]:
    """The header's fields and its length in bytes."""
    fields: dict[str, str] = {}
    with path.open("rb") as file:
        for line in file:
            key, _, value = _decoded(line).partition("=")
            fields.setdefault(key.strip(), value.strip())  # as MetaIO: the first one counts
            if key.strip() == "ElementDataFile":
                break
        return fields, file.tell()


def _decoded(line: bytes) -> str:
    """As SimpleITK writes names, or as old programs on Windows do."""
    try:
        return line.decode()
    except UnicodeDecodeError:
        return line.decode("latin-1")


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

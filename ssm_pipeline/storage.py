"""Read and write records: whole or not at all, with a format version.

Every record is one `.npz`: arrays as they are, sparse matrices as their three arrays, the rest
(ids, frames, numbers) in one JSON string. Nothing is pickled. A file has reached the disk before
its name does, so that after a power cut there is the old file or the new one, never half of one.
"""

from __future__ import annotations

import dataclasses
import errno
import hashlib
import io
import json
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd
import scipy.sparse as sp

from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records import DamagedFile, Metrics, StudyError

FORMAT_VERSION = 1
Record = TypeVar("Record")
Fingerprints = dict[str, tuple[int, str]]  # path below a folder → its bytes, their hash
# Record → what a field was called in files of earlier versions → what it is called now.
FORMER_NAMES = {"SpectralBasis": {"stiffness": "laplacian"}}

# What stands in the way of writing, as opposed to a fault of the program, and what to try.
WHAT_TO_TRY = {
    errno.ENOSPC: "Free some space",
    errno.EDQUOT: "Free some of your quota",
    errno.EFBIG: "Use a disk that takes larger files",
    errno.EROFS: "Choose a folder that can be written to",
    errno.EACCES: "Choose a folder that you may write to",
    errno.EPERM: "Choose a folder that you may write to",
    errno.ENOTDIR: "Choose another folder",
    errno.ENAMETOOLONG: "Choose a shorter name",
    errno.EIO: "Check the disk",
}


@contextmanager
def written_whole(path: Path, mode: int = 0o644) -> Iterator[Path]:
    """Yield a temporary sibling of `path`; move it there only if the block succeeds.

    Args:
        mode: Who may read it, from its first byte on: a run folder is shared, so all by default;
            0o600: its owner.

    Raises:
        StudyError: Where the disk is full, or the folder can't be written to.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(
            dir=path.parent, prefix=f".{path.name}.", suffix=path.suffix
        )
        os.close(handle)
        temporary = Path(name)
        try:
            yield temporary
            temporary.chmod(mode)  # until here mkstemp has kept it private
            reach_disk(temporary)
            temporary.replace(path)
            reach_disk(path.parent)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise_if_unwritable(path, error)
        raise


def raise_if_unwritable(path: Path, error: OSError) -> None:
    """Raise StudyError for a full disk or a folder closed to us; other errors are left alone."""
    if error.errno in WHAT_TO_TRY:
        raise StudyError(
            f"{path} can't be written: {error.strerror}. {WHAT_TO_TRY[error.errno]}, then run the "
            "same command again; what is finished is kept."
        ) from error


def remove(path: Path) -> None:
    """Delete a file, if it is there; a power cut does not bring it back."""
    if path.exists():
        path.unlink()
        reach_disk(path.parent)


def remove_unfinished(folder: Path) -> None:
    """Delete what processes that were killed inside `written_whole` left below a folder."""
    for path in folder.rglob(".*.*"):
        if path.is_file():
            path.unlink()


def fingerprints(folder: Path, paths: Iterable[Path]) -> Fingerprints:
    """Size and hash of files below a folder, to tell later whether they are still as written."""
    return {path.relative_to(folder).as_posix(): _fingerprint(path) for path in sorted(paths)}


def not_as_written(
    folder: Path, written: Mapping[str, tuple[int, str]], by_content: bool = False
) -> list[DamagedFile]:
    """What is wrong with files of which `fingerprints` were taken; by size alone, or by content."""
    found = []
    for name, (size, content) in written.items():
        path = folder / name
        if not path.is_file():
            found.append(DamagedFile(path, "is missing"))
        elif (now := path.stat().st_size) != size:
            found.append(DamagedFile(path, f"has {now} bytes; {size} were written"))
        elif by_content and _fingerprint(path)[1] != content:
            found.append(DamagedFile(path, "has changed since it was written"))
    return found


def _fingerprint(path: Path) -> tuple[int, str]:
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16))
        return file.tell(), digest.hexdigest()


def reach_disk(path: Path) -> None:
    """Return when a file's content, or a folder's list of names, is on the disk itself."""
    if path.is_dir() and os.name == "nt":
        return  # Windows can't open a folder; its file system orders the names itself
    handle = os.open(path, os.O_RDONLY if os.name != "nt" else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_text(path: Path, text: str) -> None:
    with written_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_bytes(path: Path, content: memoryview) -> None:
    """Of what a library made in memory: its own writer may not say that the disk is full."""
    with written_whole(path) as temporary:
        temporary.write_bytes(content)


def write_json(path: Path, content: Any) -> None:
    write_text(path, json.dumps(content, indent=2) + "\n")


def read_json(path: Path) -> Any:
    """Raises DamagedFile for a file that is missing or no JSON."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise DamagedFile(path, "is missing") from error
    except (ValueError, RecursionError) as error:
        raise DamagedFile(path, f"is not readable as JSON ({error})") from error


def save(record: Any, path: Path) -> None:
    """Write a dataclass record to `path` (.npz)."""
    arrays: dict[str, np.ndarray] = {}
    rest: dict[str, Any] = {}
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        if isinstance(value, np.ndarray):
            arrays[field.name] = value
        elif sp.issparse(value):
            csr = value.tocsr()
            arrays |= {f"{field.name}.data": csr.data, f"{field.name}.indices": csr.indices}
            arrays[f"{field.name}.indptr"] = csr.indptr
            rest[field.name] = {"sparse": list(csr.shape)}
        else:
            rest[field.name] = _to_json(value)
    header = {"record": type(record).__name__, "format_version": FORMAT_VERSION, "fields": rest}
    save_arrays(arrays | {"header": np.array(json.dumps(header))}, path)


def load(kind: type[Record], path: Path) -> Record:
    """Read a record of the given class.

    Raises:
        DamagedFile: If the file does not hold a whole one.

    >>> load(Similarity, Path("runs/none.npz"))
    Traceback (most recent call last):
    ssm_pipeline.records.errors.DamagedFile: runs/none.npz is missing. If a run made it, ...
    """
    with damage_named(path), path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
        return _record(kind, path, file)


def save_arrays(arrays: dict[str, np.ndarray], path: Path, compressed: bool = False) -> None:
    """An `.npz` of these arrays, which any NumPy opens without `allow_pickle`."""
    buffer = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(buffer, **arrays)  # type: ignore[arg-type]
    write_bytes(path, buffer.getbuffer())


def load_arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays of an `.npz`, by name. Raises DamagedFile."""
    with damage_named(path), path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
        return dict(file)


@contextmanager
def damage_named(path: Path) -> Iterator[None]:
    """Whatever reading the file raises inside the block becomes a DamagedFile that names it."""
    try:
        yield
    except FileNotFoundError as error:
        raise DamagedFile(path, "is missing") from error
    except (DamagedFile, PermissionError):
        raise
    except Exception as error:  # damaged bytes can break the decoders anywhere
        what = f"is damaged or cut short ({type(error).__name__}: {error})"
        raise DamagedFile(path, what) from error


def _record(kind: type[Record], path: Path, file: Any) -> Record:
    header = json.loads(str(file["header"]))
    if header["record"] != kind.__name__ or header["format_version"] != FORMAT_VERSION:
        raise DamagedFile(
            path,
            f"holds a {header['record']} of format {header['format_version']}; a {kind.__name__} "
            f"of format {FORMAT_VERSION} is needed",
        )
    values: dict[str, Any] = {
        name: file[name] for name in file.files if name != "header" and "." not in name
    }
    for name, value in header["fields"].items():
        if isinstance(value, dict) and "sparse" in value:
            parts = tuple(file[f"{name}.{part}"] for part in ("data", "indices", "indptr"))
            values[name] = sp.csr_matrix(parts, shape=tuple(value["sparse"]))
            values[name].check_format(full_check=True)  # an index too large would crash SciPy
        else:
            values[name] = _from_json(value)
    former = FORMER_NAMES.get(kind.__name__, {})
    return kind(**{former.get(name, name): value for name, value in values.items()})


def save_tables(metrics: Metrics, folder: Path) -> None:
    """One CSV a table in `folder`."""
    for name, table in metrics.tables.items():
        write_table(table, folder / f"{name}.csv")


def load_tables(folder: Path) -> Metrics:
    """The tables that `save_tables` wrote. Raises DamagedFile."""
    return Metrics({path.stem: read_table(path) for path in sorted(folder.glob("*.csv"))})


def write_table(table: pd.DataFrame, path: Path, mode: int = 0o644) -> None:
    """mode: as `written_whole`."""
    with written_whole(path, mode) as temporary:
        table.to_csv(temporary, index=False)


# Columns of ids and names, which stay text whatever they look like.
_TEXT = dict.fromkeys(
    (
        *("case_id", "from_case_id", "copy_of", "nearest_by_surface", "nearest_by_chamfer"),
        *("patient", "left_out", "visit", "side", "site", "landmark"),
    ),
    str,
)


def read_table(path: Path, text: Iterable[str] = tuple(_TEXT)) -> pd.DataFrame:
    """Read a table that `write_table` wrote; the columns `text` are text. Raises DamagedFile."""
    try:
        # Case ids stay the text they are: "007" is no number, and a case may be called NA. What is
        # missing is written as nothing.
        return pd.read_csv(
            path, dtype=dict.fromkeys(text, str), keep_default_na=False, na_values=[""]
        )
    except FileNotFoundError as error:
        raise DamagedFile(path, "is missing") from error
    except (ValueError, pd.errors.ParserError) as error:  # EmptyDataError is a ValueError
        raise DamagedFile(path, f"is not readable as a table ({error})") from error


def _to_json(value: Any) -> Any:
    if isinstance(value, Similarity):
        return {
            "frame": [value.scale, value.rotation.tolist(), value.translation.tolist()],
        }
    if isinstance(value, tuple | list):
        return {"tuple": [_to_json(item) for item in value]}
    if isinstance(value, str | int | float | bool) or value is None:
        return value
    raise TypeError(f"a {type(value).__name__} can't be stored in a record")


def _from_json(value: Any) -> Any:
    if isinstance(value, dict) and "frame" in value:
        scale, rotation, translation = value["frame"]
        return Similarity(scale, np.array(rotation), np.array(translation))
    if isinstance(value, dict) and "tuple" in value:
        return tuple(_from_json(item) for item in value["tuple"])
    return value

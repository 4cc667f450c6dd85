"""Read and write records: whole or not at all, with a format version.

Every record is one `.npz`: arrays as they are, sparse matrices as their three arrays, the rest
(ids, frames, numbers) in one JSON string. Nothing is pickled.
"""

from __future__ import annotations

import dataclasses
import io
import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd
import scipy.sparse as sp

from ssm_pipeline.records import Frame, Metrics

FORMAT_VERSION = 1
Record = TypeVar("Record")


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Yield a temporary sibling of `path`; move it there only if the block succeeds."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=path.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o644)  # mkstemp makes it private; a run folder is shared
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    with written_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, content: Any) -> None:
    write_text(path, json.dumps(content, indent=2) + "\n")


def read_json(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


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
    arrays["header"] = np.array(json.dumps(header))
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    with written_whole(path) as temporary:
        temporary.write_bytes(buffer.getbuffer())


def load(kind: type[Record], path: Path) -> Record:
    """Read a record of the given class. Raises ValueError if the file holds another kind."""
    with np.load(path, allow_pickle=False) as file:
        header = json.loads(str(file["header"]))
        if header["record"] != kind.__name__ or header["format_version"] != FORMAT_VERSION:
            raise ValueError(
                f"{path} holds a {header['record']} of format {header['format_version']}; "
                f"a {kind.__name__} of format {FORMAT_VERSION} is needed. "
                "Delete the file and run again."
            )
        values: dict[str, Any] = {
            name: file[name] for name in file.files if name != "header" and "." not in name
        }
        for name, value in header["fields"].items():
            if isinstance(value, dict) and "sparse" in value:
                parts = tuple(file[f"{name}.{part}"] for part in ("data", "indices", "indptr"))
                values[name] = sp.csr_matrix(parts, shape=tuple(value["sparse"]))
            else:
                values[name] = _from_json(value)
    return kind(**values)


def save_tables(metrics: Metrics, folder: Path) -> None:
    """One CSV a table in `folder`."""
    for name, table in metrics.tables.items():
        with written_whole(folder / f"{name}.csv") as temporary:
            table.to_csv(temporary, index=False)


def load_tables(folder: Path) -> Metrics:
    # Case ids stay text: "007" is no number.
    as_text = {"case_id": str}
    paths = sorted(folder.glob("*.csv"))
    return Metrics({path.stem: pd.read_csv(path, dtype=as_text) for path in paths})


def _to_json(value: Any) -> Any:
    if isinstance(value, Frame):
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
        return Frame(scale, np.array(rotation), np.array(translation))
    if isinstance(value, dict) and "tuple" in value:
        return tuple(_from_json(item) for item in value["tuple"])
    return value

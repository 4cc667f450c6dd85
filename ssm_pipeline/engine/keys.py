"""Keys: short hashes of everything a result depends on. Same key, same result."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from ssm_pipeline.settings import Settings
from ssm_pipeline.storage import FORMAT_VERSION


def key_of(*parts: Any) -> str:
    """Hash settings, numbers, strings, and lists, tuples and dictionaries of them."""
    text = json.dumps([FORMAT_VERSION, *parts], sort_keys=True, default=_plain)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def key_of_files(paths: Iterable[Path]) -> str:
    """Hash the contents of files in the given order; their paths and dates do not count."""
    digest = hashlib.blake2b(digest_size=16)
    for path in paths:
        digest.update(path.suffix.encode())
        with path.open("rb") as file:
            digest.update(hashlib.file_digest(file, "blake2b").digest())
    return digest.hexdigest()


def key_of_arrays(*arrays: np.ndarray) -> str:
    """Hash the contents of arrays."""
    digest = hashlib.blake2b(digest_size=16)
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _plain(value: Any) -> Any:
    if isinstance(value, Settings):
        return value.model_dump(mode="json")
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"a {type(value).__name__} can't be part of a key")

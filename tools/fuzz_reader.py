"""What `fuzz.py` needs of a reader: a good file to start from, and how it is read."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

GZIP = (gzip.decompress, gzip.compress)


@dataclass(frozen=True)
class Reader:
    """`write(folder)` makes a good file and returns the one to damage; `read(path)` reads it.

    inner  what is damaged instead of the file's own bytes: (unpack, pack), for compressed files
           whose checksum would otherwise refuse nearly every input at once.
    """

    name: str
    write: Callable[[Path], Path]
    read: Callable[[Path], object]
    inner: tuple[Callable[[bytes], bytes], Callable[[bytes], bytes]] | None = None

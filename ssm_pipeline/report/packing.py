"""Arrays as compact binary blocks inside the page: little-endian, base64, points as 16 bits."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np


class Block:
    """A growing binary block. `add…` returns where and how the array lies in it, for the viewer."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._length = 0

    def add_numbers(self, values: np.ndarray) -> dict[str, Any]:
        """Any shape as int16: off by at most half of extent / 65535, some µm for an organ in mm."""
        low, high = float(values.min()), float(values.max())
        scale = max(high - low, 1e-6) / 65535
        origin = low + 32768 * scale
        numbers = np.clip(np.round((values - origin) / scale), -32768, 32767).astype("<i2")
        return self._add(numbers, "int16") | {"scale": scale, "origin": origin}

    def add_indices(self, indices: np.ndarray) -> dict[str, Any]:
        """Non-negative integers, 16 bits each where they fit."""
        short = int(indices.max(initial=0)) < 65536
        return self._add(indices.astype("<u2" if short else "<u4"), "uint16" if short else "uint32")

    def base64(self) -> str:
        return base64.b64encode(b"".join(self._parts)).decode()

    def _add(self, array: np.ndarray, kind: str) -> dict[str, Any]:
        data = array.tobytes()
        data += b"\0" * (-len(data) % 4)  # typed arrays start at multiples of their item size
        place = {"type": kind, "offset": self._length, "shape": list(array.shape)}
        self._parts.append(data)
        self._length += len(data)
        return place

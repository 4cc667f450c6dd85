"""glTF binary (.glb): the mean with one morph target per mode, for web viewers and Blender."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from ssm_pipeline import storage
from ssm_pipeline.shape_model.model import ShapeModel

_FLOAT, _UINT32 = 5126, 5125
_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER = 34962, 34963


def glb_bytes(model: ShapeModel, modes: int | None = None) -> bytes:
    """The model as a .glb: POSITION is the mean, target m is mode m's displacement at +1 SD.

    modes: how many leading modes to write; None writes all. The accessors hold LPS millimetres; the
    one node turns them into glTF's metres, y up, so that other programs show the organ upright and
    at its true size. `mesh.extras.targetNames` names the targets.

    Raises:
        ValueError: For more modes than the model has.

    Source: glTF 2.0 specification, 3.7.2.2.
    """
    if modes is not None:
        model = model.truncate(modes)
    buffers: list[bytes] = []
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []

    def add(array: np.ndarray, component: int, kind: str, target: int) -> int:
        data = array.tobytes()
        offset = sum(map(len, buffers))
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": len(data), "target": target})
        accessor = {
            "bufferView": len(views) - 1,
            "componentType": component,
            "count": len(array) if kind == "VEC3" else array.size,
            "type": kind,
        }
        if kind == "VEC3":  # required for POSITION, morph targets included
            accessor |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
        accessors.append(accessor)
        buffers.append(data)
        return len(accessors) - 1

    mean = add(model.mean.astype("<f4"), _FLOAT, "VEC3", _ARRAY_BUFFER)
    displacements = model.modes * model.standard_deviations[:, None, None]
    targets = [add(d.astype("<f4"), _FLOAT, "VEC3", _ARRAY_BUFFER) for d in displacements]
    faces = add(model.faces.astype("<u4"), _UINT32, "SCALAR", _ELEMENT_ARRAY_BUFFER)
    names = [f"mode {number} (+1 SD)" for number in range(1, model.mode_count + 1)]
    half = 2**-0.5
    tree = {
        "asset": {"version": "2.0", "generator": "ssm-pipeline"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        # (left, posterior, superior) → (x, −z, y): glTF looks at a model's front from +z, y up.
        "nodes": [{"mesh": 0, "rotation": [-half, 0.0, 0.0, half], "scale": [1e-3] * 3}],
        "meshes": [
            {
                "name": "mean shape",
                "primitives": [
                    {
                        "attributes": {"POSITION": mean},
                        "indices": faces,
                        "targets": [{"POSITION": target} for target in targets],
                        "mode": 4,
                    }
                ],
                "weights": [0.0] * model.mode_count,
                "extras": {
                    "targetNames": names,
                    "unit": "mm",
                    "space": "LPS",
                    "variancesMm2": model.variances.tolist(),
                },
            }
        ],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": sum(map(len, buffers))}],
    }
    text = json.dumps(tree, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)  # every chunk starts at a multiple of four
    binary = b"".join(buffers)
    length = 12 + 8 + len(text) + 8 + len(binary)
    return b"".join(
        (
            struct.pack("<4sII", b"glTF", 2, length),
            struct.pack("<I4s", len(text), b"JSON"),
            text,
            struct.pack("<I4s", len(binary), b"BIN\0"),
            binary,
        )
    )


def write_glb(model: ShapeModel, path: Path, modes: int | None = None) -> None:
    """Write `glb_bytes` to `path`, whole or not at all."""
    with storage.written_whole(path) as temporary:
        temporary.write_bytes(glb_bytes(model, modes))

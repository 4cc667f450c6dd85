"""HDF5 files in the JSON that hdf5-json and Scalismo write."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np


def as_json(path: Path) -> Path:
    """An HDF5 file in the JSON that hdf5-json and Scalismo write."""
    tree: dict[str, Any] = {"apiVersion": "1.0.0", "root": "/", "groups": {}, "datasets": {}}

    def of(value: Any) -> Any:
        value = np.asarray(value)
        return value.item().decode() if value.dtype.kind == "S" else value.tolist()

    def add(name: str, group: h5py.Group) -> None:
        content: dict[str, Any] = {"attributes": [], "links": []}
        tree["groups"][name] = content
        content["attributes"] = [{"name": k, "value": of(v)} for k, v in group.attrs.items()]
        for title, member in group.items():
            kind = "groups" if isinstance(member, h5py.Group) else "datasets"
            content["links"].append(
                {"class": "H5L_TYPE_HARD", "title": title, "collection": kind, "id": member.name}
            )
            if kind == "groups":
                add(member.name, member)
            else:
                tree["datasets"][member.name] = {"value": of(member[()])}

    with h5py.File(path, "r") as file:
        add("/", file)
    path.with_suffix(".h5.json").write_text(json.dumps(tree))
    return path.with_suffix(".h5.json")

"""HDF5 content as JSON (`.h5.json`, as Scalismo writes it), as an HDF5 file in memory."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import h5py

from ssm_pipeline.records import StudyError

DEEPEST = 20  # groups within groups: a damaged file may link a group to itself


def hdf5_of_json(content: bytes, path: Path) -> h5py.File:
    """The tree of groups, datasets and attributes that a JSON file describes.

    Raises:
        StudyError: the file is no JSON, or describes no HDF5 tree.

    Source: The HDF Group, hdf5-json; of its links only hard ones are followed.
    """
    try:
        tree = json.loads(content)
        file = h5py.File(io.BytesIO(), "w")
        _fill(file, tree["root"], tree, 0)
    except (ValueError, LookupError, TypeError, AttributeError, OSError, RecursionError) as error:
        raise StudyError(
            f"{path} holds no HDF5 content as JSON ({type(error).__name__}: {error}). Save the "
            "model again with Scalismo's StatismoIO, as .h5.json or .h5."
        ) from error
    return file


def _fill(group: h5py.Group, identifier: str, tree: dict[str, Any], depth: int) -> None:
    if depth > DEEPEST:
        raise ValueError(f"groups are nested more than {DEEPEST} deep")
    content = tree["groups"][identifier]
    for attribute in content.get("attributes", ()):
        group.attrs[str(attribute["name"])] = attribute["value"]
    for link in content.get("links", ()):
        name = str(link.get("title", ""))
        if link.get("collection") == "groups":
            _fill(group.create_group(name), link["id"], tree, depth + 1)
        elif link.get("collection") == "datasets":
            group[name] = tree["datasets"][link["id"]]["value"]

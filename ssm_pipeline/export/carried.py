"""Landmarks and labels of the template, on another shape, as 3D Slicer opens them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ssm_pipeline.data_prep.formats.tables import read_table
from ssm_pipeline.export.vtp import write_poly_data
from ssm_pipeline.records import StudyError

MARKUPS_SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/"
    "Schema/markups-schema-v1.0.3.json#"
)


def markups(
    names: Sequence[str], positions: np.ndarray, remarks: Sequence[str] | None = None
) -> dict[str, Any]:
    """The content of a `.mrk.json`: a point list of positions (L, 3) mm LPS.

    Args:
        remarks: `(L,)`, the points' descriptions. None: no description.
    """
    remarks = [""] * len(names) if remarks is None else remarks
    return {
        "@schema": MARKUPS_SCHEMA,
        "markups": [
            {
                "type": "Fiducial",
                "coordinateSystem": "LPS",
                "coordinateUnits": "mm",
                "controlPoints": [
                    {
                        "id": str(number),
                        "label": name,
                        "description": remark,
                        "position": [round(float(value), 4) for value in position],
                        "positionStatus": "defined",
                    }
                    for number, (name, position, remark) in enumerate(
                        zip(names, positions, remarks, strict=True), start=1
                    )
                ],
            }
        ],
    }


def read_vertex_labels(path: Path, vertex_count: int) -> np.ndarray:
    """(V,) text: the label of every template vertex, "" where the table gives none.

    A table with columns vertex (from 0, as in meshes/template.ply) and label. Raises StudyError.
    """
    table = read_table(path)
    if missing := [name for name in ("vertex", "label") if name not in table]:
        raise StudyError(
            f"{path} has no column {' and no column '.join(missing)}; vertex and label are needed."
        )
    try:
        vertices = table["vertex"].astype(int).to_numpy()
    except ValueError as error:
        raise StudyError(f"{path}: a vertex is no whole number ({error}).") from error
    if not len(vertices) or vertices.min() < 0 or vertices.max() >= vertex_count:
        found = f"{vertices.min()} to {vertices.max()}" if len(vertices) else "none"
        raise StudyError(
            f"{path} names vertices {found}; 0 to {vertex_count - 1} are the template's. Number "
            "them as in meshes/template.ply of `workflow export`."
        )
    if len(np.unique(vertices)) < len(vertices):
        doubled = table["vertex"][table["vertex"].duplicated()].iloc[0]
        raise StudyError(f"{path} gives vertex {doubled} two labels; one per vertex is needed.")
    labels = np.full(vertex_count, "", dtype=object)
    labels[vertices] = table["label"].to_numpy()
    return labels


def write_labelled_surface(
    vertices: np.ndarray,
    faces: np.ndarray,
    labels: np.ndarray,
    path: Path,
    observed: np.ndarray | None = None,
) -> None:
    """A `.vtp` with the point array `label`: 1, 2 … in the order of the labels' names, 0 for none.

    The names are in the field array `label_names`.

    Args:
        observed: `(V,)` bool, of a fitted patient: written as a point array. None: left out.
    """
    import pyvista

    names = sorted({label for label in labels if label})
    code = {name: number for number, name in enumerate(names, start=1)} | {"": 0}
    mesh = pyvista.PolyData.from_regular_faces(vertices, faces)
    mesh.point_data["label"] = np.array([code[label] for label in labels], dtype=np.int32)
    if observed is not None:
        mesh.point_data["observed"] = observed.astype(np.int32)
    mesh.field_data["SPACE"] = ["LPS"]
    mesh.field_data["UNIT"] = ["mm"]
    mesh.field_data["label_names"] = names
    write_poly_data(mesh, path)

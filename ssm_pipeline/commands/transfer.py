"""`workflow transfer`: map the template's landmarks and labels to cases and fitted patients."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.commands.export_folder import note_export
from ssm_pipeline.data_prep.formats.landmarks import Landmarks
from ssm_pipeline.export.carried import markups, read_vertex_labels, write_labelled_surface
from ssm_pipeline.geometry.barycentric import interpolated
from ssm_pipeline.geometry.closest_point import closest_points
from ssm_pipeline.geometry.surface import volume
from ssm_pipeline.records import StudyError
from ssm_pipeline.report.landmarks import carry_landmarks
from ssm_pipeline.runs.landmark_file import landmarks_on_template
from ssm_pipeline.runs.run import Run, load_run

MIRROR = np.array([-1.0, 1.0, 1.0])
FITTED_FILE = "reconstruction.vtp"  # of `workflow fit`, a folder per patient
FITTED_ARRAYS = ("observed", "radius_90_mm")
SMALLEST_WEIGHT = 1e-6  # of a corner of the triangle that a landmark lies in
COLUMNS = [
    "case_id",
    "landmark",
    "left_mm",
    "posterior_mm",
    "superior_mm",
    "observed",
    "radius_mm",
]


@dataclass(frozen=True, eq=False)
class _Shape:
    """A case or a fitted patient in correspondence with the template, in its scan's millimetres.

    Attributes:
        vertices: `(V, 3)`, mm.
        is_reflected: Whether the triangles must be reversed to face outward.
        observed: `(V,)` bool: where a patient's surface was seen. None for cases of the run.
        radius_mm: `(V,)`: 90 % of the true positions are this near, by the model. None likewise.
    """

    vertices: np.ndarray
    is_reflected: bool
    observed: np.ndarray | None = None
    radius_mm: np.ndarray | None = None


def transfer(
    run_folder: Path,
    folder: Path,
    landmarks: Path | None = None,
    labels: Path | None = None,
    fits: Path | None = None,
) -> list[Path]:
    """Write `<case>/landmarks.mrk.json` and `<case>/labels.vtp`, each in its scan's millimetres.

    A case that the study mirrors is mirrored back. Points of a fitted patient that lie where the
    surface was not observed are marked: the model predicts their positions.

    Args:
        landmarks: A Slicer `.mrk.json` or `.fcsv`, placed on the template.
        labels: A table of vertex and label.
        fits: A folder that `workflow fit` wrote; its patients are added.

    Returns:
        The paths written; `landmarks.csv` holds all points in one table.

    Raises:
        StudyError: If neither landmarks nor labels are given, points lie far from the template, or
            a file can't be read.
    """
    if landmarks is None and labels is None:
        raise StudyError("there is nothing to transfer. Pass --landmarks, --labels or both.")
    run = load_run(run_folder)
    shapes = _cases(run)
    if fits is not None:
        shapes |= _fitted(fits, run.shapes.template, run.shapes.faces, shapes)
    written: list[Path] = []
    if landmarks is not None:
        placed = landmarks_on_template(landmarks, run, "--landmarks")
        written += _write_landmarks(placed, run, shapes, folder)
    if labels is not None:
        of_vertices = read_vertex_labels(labels, len(run.shapes.template))
        for case_id, shape in shapes.items():
            written.append(folder / case_id / "labels.vtp")
            faces = run.shapes.faces[:, ::-1] if shape.is_reflected else run.shapes.faces
            write_labelled_surface(shape.vertices, faces, of_vertices, written[-1], shape.observed)
    note_export(run_folder, folder)  # it names the cases: `workflow forget` tells of it
    return written


def _cases(run: Run) -> dict[str, _Shape]:
    shapes = {}
    for case_id, vertices in zip(run.shapes.case_ids, run.shapes.vertices, strict=True):
        is_reflected = case_id in run.reflected
        shapes[case_id] = _Shape(vertices * MIRROR if is_reflected else vertices, is_reflected)
    return shapes


def _write_landmarks(
    placed: Landmarks, run: Run, shapes: dict[str, _Shape], folder: Path
) -> list[Path]:
    """Write one file per shape, and one table.

    Returns:
        The paths.
    """
    template, faces = run.shapes.template, run.shapes.faces
    vertices = np.stack([shape.vertices for shape in shapes.values()])
    transferred = carry_landmarks(placed.positions, template, faces, vertices)
    nearest = closest_points(placed.positions, template, faces)
    corners, weights = faces[nearest.faces], nearest.barycentric
    written, rows = [], []
    for (case_id, shape), positions in zip(shapes.items(), transferred, strict=True):
        observed = np.ones(len(positions), bool)
        radius_mm = np.full(len(positions), np.nan)
        if shape.observed is not None and shape.radius_mm is not None:
            observed = (shape.observed[corners] | (weights < SMALLEST_WEIGHT)).all(axis=1)
            radius_mm = interpolated(shape.radius_mm[:, None], corners, weights)[:, 0]
        remarks = [
            "" if seen else f"not observed: placed by the model, within {radius:.1f} mm (90 %)"
            for seen, radius in zip(observed, radius_mm, strict=True)
        ]
        written.append(folder / case_id / "landmarks.mrk.json")
        storage.write_json(written[-1], markups(placed.names, positions, remarks))
        rows += [
            (case_id, name, *position, seen, radius)
            for name, position, seen, radius in zip(
                placed.names, positions, observed, radius_mm, strict=True
            )
        ]
    written.append(folder / "landmarks.csv")
    storage.write_table(pd.DataFrame(rows, columns=COLUMNS), written[-1])
    return written


def _fitted(
    folder: Path, template: np.ndarray, faces: np.ndarray, cases: Collection[str]
) -> dict[str, _Shape]:
    """The patients in a folder that `workflow fit` wrote. Raises StudyError."""
    import pyvista

    found = sorted(folder.glob(f"*/{FITTED_FILE}"))
    if not found:
        raise StudyError(
            f"{folder} holds no fitted patients (<patient>/{FITTED_FILE}). Pass the output folder "
            "of `workflow fit`."
        )
    shapes = {}
    for path in found:
        name, surface = path.parent.name, pyvista.read(path)
        vertices = np.asarray(surface.points, float)
        if len(vertices) != len(template):
            raise StudyError(
                f"the fitted patient {name} has {len(vertices)} vertices, but the run's template "
                f"has {len(template)}: it was fitted to another model. Fit the patient again to "
                "this run."
            )
        if name in cases:
            raise StudyError(
                f"the fitted patient {name} has the same id as a case of the run. Rename the "
                "patient's file and fit it again."
            )
        if missing := [key for key in FITTED_ARRAYS if key not in surface.point_data]:
            raise StudyError(
                f"{path} has no point array {' and no '.join(missing)}, so it is unknown which "
                "part of the surface was observed. Fit the patient again with `workflow fit`."
            )
        observed, radius_mm = (np.asarray(surface.point_data[key]) for key in FITTED_ARRAYS)
        is_reflected = volume(vertices, faces) * volume(template, faces) < 0
        shapes[name] = _Shape(vertices, bool(is_reflected), observed > 0.5, radius_mm)
    return shapes

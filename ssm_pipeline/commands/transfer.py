"""`workflow transfer`: landmarks and labels of the template, on every case and fitted patient."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.commands.export_folder import note_export
from ssm_pipeline.export.carried import markups, read_vertex_labels, write_labelled_surface
from ssm_pipeline.geometry.surface import volume
from ssm_pipeline.records import StudyError
from ssm_pipeline.report.landmarks import carry_landmarks
from ssm_pipeline.runs.landmark_file import landmarks_on_template
from ssm_pipeline.runs.run import load_run

MIRROR = np.array([-1.0, 1.0, 1.0])
FITTED_FILE = "reconstruction.vtp"  # of `workflow fit`, a folder per patient


def transfer(
    run_folder: Path,
    folder: Path,
    landmarks: Path | None = None,
    labels: Path | None = None,
    fits: Path | None = None,
) -> list[Path]:
    """Write `<case>/landmarks.mrk.json` and `<case>/labels.vtp`, each in its scan's millimetres.

    A case that the study mirrors is mirrored back.

    Args:
        landmarks: A Slicer `.mrk.json`, placed on the template.
        labels: A CSV of vertex and label.
        fits: The folder of a `workflow fit`: its patients are served too.

    Returns:
        The paths written; `landmarks.csv` holds all points in one table.

    Raises:
        StudyError: For neither, for points off the template, and for files that can't be read.
    """
    if landmarks is None and labels is None:
        raise StudyError("nothing to carry over: pass --landmarks, --labels or both.")
    run = load_run(run_folder)
    shapes = run.shapes
    points = {
        case_id: vertices * MIRROR if case_id in run.reflected else vertices
        for case_id, vertices in zip(shapes.case_ids, shapes.vertices, strict=True)
    }
    turned = set(run.reflected)  # whose triangles are turned around
    if fits is not None:
        of_fits = _fitted(fits, len(shapes.vertices[0]), points)
        points |= of_fits
        turned |= {
            name
            for name, vertices in of_fits.items()
            if volume(vertices, shapes.faces) * volume(shapes.template, shapes.faces) < 0
        }
    written: list[Path] = []
    if landmarks is not None:
        placed = landmarks_on_template(landmarks, run)
        carried = carry_landmarks(
            placed.positions, shapes.template, shapes.faces, np.stack(list(points.values()))
        )
        rows = []
        for case_id, positions in zip(points, carried, strict=True):
            written.append(folder / case_id / "landmarks.mrk.json")
            storage.write_json(written[-1], markups(placed.names, positions))
            rows += [
                (case_id, name, *position)
                for name, position in zip(placed.names, positions, strict=True)
            ]
        written.append(folder / "landmarks.csv")
        names = ["case_id", "landmark", "left_mm", "posterior_mm", "superior_mm"]
        storage.write_table(pd.DataFrame(rows, columns=names), written[-1])
    if labels is not None:
        of_vertices = read_vertex_labels(labels, len(shapes.template))
        for case_id, vertices in points.items():
            written.append(folder / case_id / "labels.vtp")
            faces = shapes.faces[:, ::-1] if case_id in turned else shapes.faces
            write_labelled_surface(vertices, faces, of_vertices, written[-1])
    note_export(run_folder, folder)  # it names the cases: `workflow forget` tells of it
    return written


def _fitted(folder: Path, vertex_count: int, cases: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Patient → (V, 3) mm, of a folder that `workflow fit` wrote. Raises StudyError."""
    import pyvista

    found = sorted(folder.glob(f"*/{FITTED_FILE}"))
    if not found:
        raise StudyError(
            f"{folder} holds no fitted patients (<patient>/{FITTED_FILE}). Give the folder that "
            "`workflow fit --out` wrote."
        )
    points = {path.parent.name: np.asarray(pyvista.read(path).points, float) for path in found}
    for name, vertices in points.items():
        if len(vertices) != vertex_count:
            raise StudyError(
                f"the fitted patient {name} has {len(vertices)} vertices and the run's template "
                f"{vertex_count}: it was fitted to another model."
            )
        if name in cases:
            raise StudyError(
                f"the fitted patient {name} has the id of a case of the run. Rename the file and "
                "fit it again."
            )
    return points

"""`workflow import`: make a run of another program's model, for view, fit and export."""

from __future__ import annotations

import dataclasses
import datetime
from pathlib import Path, PurePosixPath

import numpy as np
import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.data_prep.formats.organ_size import (
    MM_OF,
    NAMES,
    Unit,
    diagonal_of,
    likely_unit,
)
from ssm_pipeline.engine.keys import key_of_arrays
from ssm_pipeline.engine.left_files import files_of_stage
from ssm_pipeline.engine.ownership import OWNER_FILE
from ssm_pipeline.engine.process import versions
from ssm_pipeline.engine.stage import StageRecord
from ssm_pipeline.export.statismo_reading import read_statismo
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.geometry.surface import volume
from ssm_pipeline.methods import FULL
from ssm_pipeline.records import CorrespondedShapes, Mesh, StudyError
from ssm_pipeline.runs.layout import ALIGNED, FRAMES, MESH, MODEL, SHAPES, TEMPLATE, Frames
from ssm_pipeline.runs.run import Run
from ssm_pipeline.shape_model.model import ShapeModel, load_model
from ssm_pipeline.stages.report import renew_report
from ssm_pipeline.study.settings import StudySettings

READERS = {".h5": read_statismo, ".h5.json": read_statismo, ".npz": load_model}
FEWEST_FACES = 1000  # of a patient's surface: a model of few vertices is fitted to more
IMPORTED = "imported"
MEAN = "mean"  # stands in for the cases where the file holds none


def import_model(
    path: Path,
    name: str | None,
    runs: Path,
    labels: tuple[int, ...],
    unit: Unit | None = None,
) -> Path:
    """Write the run folder `runs/<name>` of a model, and its report.

    The cases are those of the file's scores, as the model makes them; without scores, the mean
    alone.

    Args:
        labels: Of the organ in masks that `workflow fit` will be given.
        unit: Of the model's lengths. None: millimetres, if its size could be an organ's.

    Returns:
        The folder.

    Raises:
        StudyError: If the file holds no model, its size can't be an organ's, or the folder exists.
    """
    suffix = next((suffix for suffix in READERS if path.name.lower().endswith(suffix)), None)
    if suffix is None:
        raise StudyError(f"{path} is neither {' nor '.join(READERS)}; a model is one of these.")
    model = _checked(_in_mm(READERS[suffix](path), unit, path))
    folder = runs / (name or path.name[: -len(suffix)])
    if folder.exists() and any(folder.iterdir()):
        raise StudyError(f"{folder} exists and is not empty. Choose another name with --name.")
    if not model.case_ids:
        model = ShapeModel(
            model.mean,
            model.modes,
            model.variances,
            model.faces,
            np.zeros((1, model.mode_count)),
            (MEAN,),
        )
    settings = StudySettings.model_validate(
        {
            "description": f"A model imported from {path.name}",
            "data": {"source": "masks", "labels": list(labels or (1,))},
            "meshing": {"faces": max(FEWEST_FACES, len(model.faces))},  # as dense as the model
        }
    )
    _write_run(model, settings, folder)
    renew_report(Run(folder), settings.report)
    return folder


def _in_mm(model: ShapeModel, unit: Unit | None, path: Path) -> ShapeModel:
    diagonal = diagonal_of(model.mean)
    if diagonal == 0:
        raise StudyError(
            f"{path}: all points of the mean shape coincide. Save the model again in its program."
        )
    if unit is not None:
        scale = MM_OF[unit]
        return dataclasses.replace(
            model, mean=scale * model.mean, variances=scale**2 * model.variances
        )
    if (likely := likely_unit(diagonal)) is not None:
        raise StudyError(
            f"{path}: the mean shape is {diagonal:.3g} across, which can't be an organ's size in "
            f"millimetres. If it is in {NAMES[likely]}, pass --unit {likely}; if it is in "
            "millimetres, pass --unit mm."
        )
    return model


def _checked(model: ShapeModel) -> ShapeModel:
    """Triangles outward, and ids that can be names of folders: the last part of a path, or, where
    those are not different names, case_001 and so on."""
    inward = volume(model.mean, model.faces) < 0
    names = [PurePosixPath(case_id.replace("\\", "/")).name for case_id in model.case_ids]
    if "" in names or ".." in names or len(set(names)) < len(names):
        names = [f"case_{number:03d}" for number in range(1, len(names) + 1)]
    faces = model.faces[:, ::-1] if inward else model.faces
    return dataclasses.replace(model, faces=faces, case_ids=tuple(names))


def _write_run(model: ShapeModel, settings: StudySettings, folder: Path) -> None:
    """Write the files of a finished run that can be made from a model alone."""
    case_ids, files = model.case_ids, Run(folder)
    shapes = CorrespondedShapes(model.reconstruct(model.scores), model.faces, case_ids, case_ids[0])
    still = tuple(Similarity.identity() for _ in case_ids)
    for case_id, vertices in zip(case_ids, shapes.vertices, strict=True):
        mesh = Mesh(vertices, model.faces, case_id)
        storage.save(mesh, files.where(MESH, case_id))
    tables = {
        "meshing/quality": pd.DataFrame(
            {
                "case_id": case_ids,
                "vertices": len(model.mean),
                "faces": len(model.faces),
                "warnings": "",
            }
        ),
        "evaluation/compactness": pd.DataFrame(
            {
                "method": FULL,
                "modes": np.arange(1, model.mode_count + 1),
                "variance_mm2": model.variances,
                "compactness": model.compactness,
            }
        ),
        "cohort_check/cohort_check": pd.DataFrame(columns=["case_id", "remarks"]),
        "evaluation/correspondence": pd.DataFrame(
            columns=["case_id", "method", "seed", "fit_mm", "fit_hd95_mm"]
        ),
    }
    for place, table in tables.items():
        storage.write_table(table, folder / f"{place}.csv")
    storage.write_json(files.where(TEMPLATE), {"template_id": case_ids[0]})
    storage.save(shapes, files.where(SHAPES))
    storage.save(shapes, files.where(ALIGNED))
    storage.save(Frames(case_ids, still), files.where(FRAMES))
    model.save(files.where(MODEL))
    storage.write_text(folder / "study.yaml", settings.to_yaml())
    key = key_of_arrays(model.mean, model.modes, model.variances)
    for stage in (
        "meshing",
        "cohort_check",
        "correspondence",
        "groupwise",
        "shape_model",
        "evaluation",
        "report",
    ):
        _record(folder / stage, case_ids, key).write(folder / stage)
    owner = {
        "study": folder.name,
        "synthetic": False,
        "data": settings.description,
        "cases": dict.fromkeys(case_ids, key),
    }
    storage.write_json(folder / OWNER_FILE, owner)


def _record(folder: Path, case_ids: tuple[str, ...], key: str) -> StageRecord:
    return StageRecord(
        stage=folder.name,
        key=key,
        settings={},
        seed=0,
        inputs={},
        versions=versions(),
        finished_at=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        seconds=0.0,
        peak_memory_mb=0.0,
        cases_in=list(case_ids),
        cases_out=list(case_ids),
        dropped=[],
        case_keys={},
        note=IMPORTED,
        files=storage.fingerprints(folder, files_of_stage(folder)),
    )

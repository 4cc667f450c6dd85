"""A finished run, read back: `load_run("runs/luna16").model`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from ssm_pipeline import storage
from ssm_pipeline.cohort_check.copies import COLUMNS, copy_pairs, held_together
from ssm_pipeline.data_prep.cohorts.sides import is_mirrored
from ssm_pipeline.engine.keys import key_of_arrays
from ssm_pipeline.engine.stage import StageRecord
from ssm_pipeline.export.comparison_files import ABOUT_FILE, read_comparison
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records import (
    CorrespondedShapes,
    Correspondence,
    DamagedFile,
    Dropped,
    Mesh,
    Metrics,
    ShapePath,
    StudyError,
)
from ssm_pipeline.shape_model.model import ShapeModel, load_model
from ssm_pipeline.statistics.compare import ShapeComparison

COMPARISONS = "compare"  # the folder of a run that `workflow compare` writes to


@dataclass(frozen=True)
class Frames:
    """Per case, the frame from its own millimetres to the model's."""

    case_ids: tuple[str, ...]
    frames: tuple[Similarity, ...]


@dataclass(frozen=True)
class Run:
    """The results in a run's folder; each is read when it is first asked for."""

    folder: Path

    @cached_property
    def model(self) -> ShapeModel:
        return load_model(self._file("shape_model", "model.npz"))

    @cached_property
    def shapes(self) -> CorrespondedShapes:
        """The corresponded shapes, each in its own millimetres."""
        return storage.load(CorrespondedShapes, self._file("groupwise", "shapes.npz"))

    @cached_property
    def aligned(self) -> CorrespondedShapes:
        """The corresponded shapes in the model's frame."""
        return storage.load(CorrespondedShapes, self._file("shape_model", "aligned.npz"))

    @property
    def frames(self) -> dict[str, Similarity]:
        """Case → frame from its own millimetres to the model's."""
        stored = storage.load(Frames, self._file("shape_model", "frames.npz"))
        return dict(zip(stored.case_ids, stored.frames, strict=True))

    @property
    def cases(self) -> tuple[str, ...]:
        """The cases in the model, in its order."""
        return self.model.case_ids

    @property
    def patients(self) -> dict[str, str]:
        """Case → patient, of the cases in the model. Copies of one case count as one patient. An
        imported model knows no patients: each case counts as one."""
        path = self.folder / "data" / "cohort.csv"
        known: dict[str, str] = {}
        if path.exists():
            table = storage.read_table(path)
            known = dict(zip(table["case_id"], table["patient"], strict=True))
        own = {case_id: known.get(case_id, case_id) for case_id in self.cases}
        return held_together(own, copy_pairs(self.copies))

    @property
    def copies(self) -> pd.DataFrame:
        """A row per case that is a copy of another: case_id, copy_of, and the line `exclude` for
        `data.exclude` of the study. Empty if there are none, and for an imported model."""
        path = self.folder / "cohort_check" / "copies.csv"
        return storage.read_table(path) if path.exists() else pd.DataFrame(columns=list(COLUMNS))

    @property
    def reflected(self) -> frozenset[str]:
        """The cases whose side is mirrored (data.mirror): their meshes and shapes are mirror images
        of what the scans hold, x → −x."""
        mirrored = self.settings["data"].get("mirror")
        return frozenset(case_id for case_id in self.cases if is_mirrored(case_id, mirrored))

    @property
    def dropped(self) -> tuple[Dropped, ...]:
        return tuple(Dropped(**case) for stage in self.stages for case in stage.dropped)

    @property
    def template_id(self) -> str:
        result: str = storage.read_json(self._file("correspondence", "template.json"))[
            "template_id"
        ]
        return result

    def mesh(self, case_id: str) -> Mesh:
        """A case's own surface, in its own millimetres (LPS)."""
        return storage.load(Mesh, self._file("meshing", case_id, "mesh.npz"))

    def correspondence(self, case_id: str) -> Correspondence:
        """The template matched to the case, before the groupwise rounds; `shapes` is after."""
        path = self._file("correspondence", case_id, "correspondence.npz")
        return storage.load(Correspondence, path)

    def path(self, case_id: str) -> ShapePath:
        """The interpolation template → case.

        Raises:
            StudyError: For a case without one.
        """
        return storage.load(ShapePath, self._file("correspondence", "paths", case_id, "path.npz"))

    @property
    def path_cases(self) -> tuple[str, ...]:
        """The cases that `path` knows; `report.paths` in the settings is their number."""
        found = (self.folder / "correspondence" / "paths").glob("*/path.npz")
        return tuple(sorted(path.parent.name for path in found))

    @property
    def metrics(self) -> Metrics:
        """The evaluation's tables by name, units in the column names."""
        return storage.load_tables(self._file("evaluation", "stage.json").parent)

    @property
    def model_key(self) -> str:
        """What tells this model from another: results of others' are not shown as its own."""
        model = self.model
        return key_of_arrays(model.mean, model.modes, model.variances, model.scores)

    @property
    def comparisons(self) -> tuple[ShapeComparison, ...]:
        """What `workflow compare` found of this model, by formula.

        Raises:
            StudyError: For files that are damaged.
        """
        try:
            return tuple(
                read_comparison(path.parent)
                for path in sorted((self.folder / COMPARISONS).glob(f"*/{ABOUT_FILE}"))
                if storage.read_json(path).get("model_key") == self.model_key
            )
        except DamagedFile as error:
            raise StudyError(
                f"the comparison {error.path.parent} can't be shown: {error.path.name} "
                f"{error.found}. Delete that folder, or compare anew."
            ) from error

    @property
    def mesh_quality(self) -> pd.DataFrame:
        """A row per case: triangles, Euler number, volume and its change, warnings."""
        return _with_text(self._file("meshing", "quality.csv"), "warnings")

    @property
    def cohort_check(self) -> pd.DataFrame:
        """A row per case: how far it is from the others; `remarks` says what is striking of it."""
        return _with_text(self._file("cohort_check", "cohort_check.csv"), "remarks")

    @property
    def stages(self) -> tuple[StageRecord, ...]:
        """What each finished stage left in its `stage.json`, in the order they finished."""
        records = (StageRecord.read(path.parent) for path in self.folder.glob("*/stage.json"))
        found = [record for record in records if record is not None]
        return tuple(sorted(found, key=lambda record: record.finished_at))

    @property
    def settings(self) -> dict[str, Any]:
        result: dict[str, Any] = yaml.safe_load(
            self._file("study.yaml").read_text(encoding="utf-8")
        )
        return result

    def _file(self, *parts: str) -> Path:
        """A file of a stage.

        Raises:
            StudyError: If it is absent, or its stage was cut off.
        """
        path = self.folder.joinpath(*parts)
        if len(parts) > 1 and not (self.folder / parts[0] / "stage.json").exists():
            raise StudyError(
                f"{self.folder}: the stage {parts[0]} is not finished, so its files may be of "
                "other settings. Let the run come to its end: workflow run."
            )
        if not path.exists():
            raise StudyError(
                f"{self.folder} has no {'/'.join(parts)}. Check the case id, or let the run come "
                "to its end: workflow run."
            )
        return path


def _with_text(path: Path, column: str) -> pd.DataFrame:
    """A table with a column of text, empty where nothing is written: also where nowhere is."""
    table = storage.read_table(path)
    return table.astype({column: object}).fillna({column: ""})


def load_run(folder: str | Path) -> Run:
    """The results of a finished run, each read when it is first used.

    Args:
        folder: The folder of the run, such as "runs/luna16".

    Returns:
        `.model`, `.shapes` (N, V, 3) mm, `.mesh(case)`, `.path(case)`, `.metrics` and others.

    Raises:
        StudyError: For a folder that holds no run.
    """
    if not (Path(folder) / "study.json").is_file():
        raise StudyError(f"{folder} holds no run; give a folder such as runs/luna16.")
    return Run(Path(folder))

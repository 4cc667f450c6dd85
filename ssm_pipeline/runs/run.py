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
from ssm_pipeline.runs.layout import (
    ALIGNED,
    COHORT,
    COHORT_CHECK,
    COPIES,
    CORRESPONDENCE,
    FRAMES,
    MESH,
    MESH_QUALITY,
    MODEL,
    PATH,
    SHAPES,
    TEMPLATE,
    RunFiles,
)
from ssm_pipeline.shape_model.model import ShapeModel
from ssm_pipeline.statistics.compare import ShapeComparison

COMPARISONS = "compare"  # the folder of a run that `workflow compare` writes to
SETTINGS_FILE = "study.yaml"
EVALUATION = "evaluation"  # the stage whose tables are `Run.metrics`


@dataclass(frozen=True)
class Run(RunFiles):
    """The results in a run's folder; each is read when it is first used."""

    @cached_property
    def model(self) -> ShapeModel:
        return self.load(MODEL)

    @cached_property
    def shapes(self) -> CorrespondedShapes:
        """The corresponded shapes, each in its own millimetres."""
        return self.load(SHAPES)

    @cached_property
    def aligned(self) -> CorrespondedShapes:
        """The corresponded shapes in the model's frame."""
        return self.load(ALIGNED)

    @property
    def frames(self) -> dict[str, Similarity]:
        """Case → frame from its own millimetres to the model's."""
        stored = self.load(FRAMES)
        return dict(zip(stored.case_ids, stored.frames, strict=True))

    @property
    def cases(self) -> tuple[str, ...]:
        """The cases in the model, in its order."""
        return self.model.case_ids

    @property
    def patients(self) -> dict[str, str]:
        """Case → patient, of the cases in the model. Copies of one case count as one patient. An
        imported model knows no patients: each case counts as one."""
        known: dict[str, str] = {}
        if self.where(COHORT).exists():
            table = COHORT.read(self.where(COHORT))
            known = dict(zip(table["case_id"], table["patient"], strict=True))
        own = {case_id: known.get(case_id, case_id) for case_id in self.cases}
        return held_together(own, copy_pairs(self.copies))

    @property
    def copies(self) -> pd.DataFrame:
        """A row per case that is a copy of another: case_id, copy_of, and the line `exclude` for
        `data.exclude` of the study. Empty if there are none, and for an imported model."""
        path = self.where(COPIES)
        return COPIES.read(path) if path.exists() else pd.DataFrame(columns=list(COLUMNS))

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
        template_id: str = self.load(TEMPLATE)["template_id"]
        return template_id

    def mesh(self, case_id: str) -> Mesh:
        """A case's own surface, in its own millimetres (LPS)."""
        return self.load(MESH, case_id)

    def correspondence(self, case_id: str) -> Correspondence:
        """The template matched to the case, before the groupwise rounds; `shapes` is after."""
        return self.load(CORRESPONDENCE, case_id)

    def path(self, case_id: str) -> ShapePath:
        """The interpolation template → case.

        Raises:
            StudyError: For a case without one.
        """
        return self.load(PATH, case_id)

    @property
    def path_cases(self) -> tuple[str, ...]:
        """The cases that `path` knows; `report.paths` in the settings is their number."""
        found = (self.stage_folder(PATH.stage) / PATH.folder).glob(f"*/{PATH.name}")
        return tuple(sorted(path.parent.name for path in found))

    @property
    def metrics(self) -> Metrics:
        """The evaluation's tables by name, units in the column names."""
        return storage.load_tables(self.finished_stage(EVALUATION))

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
        return self.load(MESH_QUALITY)

    @property
    def cohort_check(self) -> pd.DataFrame:
        """A row per case: how far it is from the others; `remarks` says what is striking of it."""
        return self.load(COHORT_CHECK)

    @property
    def stages(self) -> tuple[StageRecord, ...]:
        """What each finished stage left in its `stage.json`, in the order they finished."""
        records = (StageRecord.read(path.parent) for path in self.folder.glob("*/stage.json"))
        found = [record for record in records if record is not None]
        return tuple(sorted(found, key=lambda record: record.finished_at))

    @property
    def settings(self) -> dict[str, Any]:
        path = self.folder / SETTINGS_FILE
        if not path.is_file():
            raise StudyError(f"{self.folder} has no {SETTINGS_FILE}. Run the study again.")
        result: dict[str, Any] = yaml.safe_load(path.read_text(encoding="utf-8"))
        return result


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

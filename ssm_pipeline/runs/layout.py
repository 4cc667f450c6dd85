"""The files of a run, each defined once: its stage, its name, and how it is read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.engine.left_files import STAGE_FILE
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records import (
    CorrespondedShapes,
    Correspondence,
    Mesh,
    ShapePath,
    SpectralBasis,
    StudyError,
    SurfaceLabels,
)
from ssm_pipeline.shape_model.model import ShapeModel, load_model

Content = TypeVar("Content")


@dataclass(frozen=True)
class Frames:
    """Per case, the frame from its own millimetres to the model's."""

    case_ids: tuple[str, ...]
    frames: tuple[Similarity, ...]


@dataclass(frozen=True)
class StageFile(Generic[Content]):
    """A file that a stage writes once for all cases."""

    stage: str
    name: str
    read: Callable[[Path], Content]

    def parts(self, case_id: str | None = None) -> tuple[str, ...]:
        assert case_id is None, f"{self.name} is one file for all cases"
        return self.stage, self.name


@dataclass(frozen=True)
class CaseFile(Generic[Content]):
    """A file that a stage writes per case, below `folder` in the stage's folder."""

    stage: str
    name: str
    read: Callable[[Path], Content]
    folder: str = ""

    def parts(self, case_id: str | None = None) -> tuple[str, ...]:
        assert case_id is not None, f"{self.name} is a file per case"
        return (self.stage, *([self.folder] if self.folder else []), case_id, self.name)


def record(kind: type[Content]) -> Callable[[Path], Content]:
    return partial(storage.load, kind)


def table_with_text(*columns: str) -> Callable[[Path], pd.DataFrame]:
    """Reader of a table whose columns of text are empty where nothing is written."""

    def read(path: Path) -> pd.DataFrame:
        table = storage.read_table(path)
        return table.astype(dict.fromkeys(columns, object)).fillna(dict.fromkeys(columns, ""))

    return read


COHORT = StageFile("data", "cohort.csv", storage.read_table)
MESH = CaseFile("meshing", "mesh.npz", record(Mesh))
LABELS = CaseFile("meshing", "labels.npz", record(SurfaceLabels))
MESH_QUALITY = StageFile("meshing", "quality.csv", table_with_text("warnings"))
COHORT_CHECK = StageFile("cohort_check", "cohort_check.csv", table_with_text("remarks"))
COPIES = StageFile("cohort_check", "copies.csv", storage.read_table)
BASIS = CaseFile("spectral", "basis.npz", record(SpectralBasis))
TRAINING_BASIS = CaseFile("spectral", "training_basis.npz", record(SpectralBasis))
MATCHER: StageFile[Path] = StageFile("training", "matcher.pt", Path)  # reading it needs PyTorch
LOSSES = StageFile("training", "losses.csv", storage.read_table)
TEMPLATE_LOSSES = StageFile("training", "template_losses.csv", storage.read_table)
TEMPLATE: StageFile[dict[str, Any]] = StageFile(
    "correspondence", "template.json", storage.read_json
)
CORRESPONDENCE = CaseFile("correspondence", "correspondence.npz", record(Correspondence))
PATH = CaseFile("correspondence", "path.npz", record(ShapePath), folder="paths")
SHAPES = StageFile("groupwise", "shapes.npz", record(CorrespondedShapes))
ALIGNED = StageFile("shape_model", "aligned.npz", record(CorrespondedShapes))
FRAMES = StageFile("shape_model", "frames.npz", record(Frames))
MODEL: StageFile[ShapeModel] = StageFile("shape_model", "model.npz", load_model)
REPORT_PAGE: StageFile[Path] = StageFile("report", "index.html", Path)


@dataclass(frozen=True)
class RunFiles:
    """The files in a run's folder.

    Attributes:
        folder: The run's.
        readable: The stages whose files may be read; None: all. A stage may read those that it
            lists in `needs`, because its key depends on these alone.
    """

    folder: Path
    readable: frozenset[str] | None = None

    def stage_folder(self, stage: str) -> Path:
        """The folder of a stage. Raises LookupError for a stage that may not be read."""
        if self.readable is not None and stage not in self.readable:
            raise LookupError(
                f"files of the stage {stage} are read, and it is not in the reader's `needs` "
                f"({', '.join(sorted(self.readable))}): its key would not depend on them. Add "
                f"{stage} to `needs` in stages/list.py."
            )
        return self.folder / stage

    def where(self, file: StageFile[Any] | CaseFile[Any], case_id: str | None = None) -> Path:
        """Where a file lies, whether or not it exists. Raises as `stage_folder`."""
        stage, *rest = file.parts(case_id)
        return self.stage_folder(stage).joinpath(*rest)

    def finished_stage(self, stage: str) -> Path:
        """`stage_folder` of a stage that is finished. Raises StudyError."""
        folder = self.stage_folder(stage)
        if not (folder / STAGE_FILE).exists():
            raise StudyError(
                f"{self.folder}: the stage {stage} is not finished, so its files may be of "
                "other settings. Let the run finish: workflow run."
            )
        return folder

    def finished(self, file: StageFile[Any] | CaseFile[Any], case_id: str | None = None) -> Path:
        """`where`, of a file that exists and whose stage is finished. Raises StudyError."""
        self.finished_stage(file.stage)
        path = self.where(file, case_id)
        if not path.exists():
            raise StudyError(
                f"{self.folder} has no {'/'.join(file.parts(case_id))}. Check the case id, or let "
                "the run finish: workflow run."
            )
        return path

    def load(
        self, file: StageFile[Content] | CaseFile[Content], case_id: str | None = None
    ) -> Content:
        """The content of a file of a finished stage. Raises StudyError or DamagedFile."""
        return file.read(self.finished(file, case_id))

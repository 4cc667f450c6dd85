"""All settings of a study: one section a stage, each written by the room it belongs to."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import Field, model_validator

from data_prep.phantom_settings import PhantomSettings
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.baselines.s3m.settings import S3MSettings
from ssm_pipeline.evaluation.settings import EvaluationSettings
from ssm_pipeline.meshing.settings import MeshingSettings
from ssm_pipeline.methods import Method
from ssm_pipeline.report.settings import ReportSettings
from ssm_pipeline.settings import Settings
from ssm_pipeline.shape_model.settings import GroupwiseSettings, ShapeModelSettings
from ssm_pipeline.spectral.settings import SpectralSettings
from ssm_pipeline.training.settings import TrainingSettings


class Luna16Data(Settings):
    """Lung masks in LUNA16's own layout."""

    source: Literal["luna16"] = "luna16"
    folder: Path | None = None  # holds seg-lungs-LUNA16, or its files; --data sets it
    side: Literal["left", "right", "both"] = "left"  # lung
    subset: int | None = None  # keep the scans whose CT lies in subset<k> beside the masks
    cases: tuple[str, ...] | None = None  # series UIDs; None: all
    limit: int | None = Field(None, ge=1)  # scans; None: all
    allow_truncated: bool = True  # keep organs that touch the image border, with a warning

    @property
    def in_words(self) -> str:
        return f"the masks in {self.folder}"


class MaskFolderData(Settings):
    """A folder of label images (.nii.gz, .nii, .nrrd, .mhd, .mha) of any organ."""

    source: Literal["masks"] = "masks"
    folder: Path | None = None  # --data sets it
    labels: tuple[int, ...] = Field((1,), min_length=1)  # united to one organ
    pattern: str | None = None  # glob below the folder, such as */liver.nii.gz; None: its files
    organ: str = "organ"  # its name in messages
    cases: tuple[str, ...] | None = None  # case ids; None: all
    limit: int | None = Field(None, ge=1)  # cases; None: all
    allow_truncated: bool = True  # keep organs that touch the image border, with a warning

    @property
    def in_words(self) -> str:
        return f"the masks in {self.folder}"


class PhantomData(PhantomSettings):
    """Synthetic organs with known correspondences."""

    source: Literal["phantoms"] = "phantoms"

    @property
    def in_words(self) -> str:
        return "synthetic phantoms"


DataSettings = Annotated[Luna16Data | MaskFolderData | PhantomData, Field(discriminator="source")]


class ComparisonSettings(Settings):
    """Methods scored on the same meshes with the same settings, beside the full one."""

    methods: tuple[Method, ...] = (
        "without groupwise",
        "without adaptation",
        "spectral only",
        "adaptation only",
        "adaptation only, groupwise",
        "nearest point",
        "S3M",
    )
    s3m: S3MSettings = S3MSettings()
    retrain: bool = False  # generalisation also with a matcher trained anew without each fold


class StudySettings(Settings):
    """What is computed. How (device, processes, folder) is the command line's."""

    description: str = ""  # a line for `workflow list`
    seed: int = Field(0, ge=0)  # of every random draw
    data: DataSettings
    meshing: MeshingSettings = MeshingSettings()
    spectral: SpectralSettings = SpectralSettings()
    training: TrainingSettings = TrainingSettings()
    adaptation: AdaptationSettings = AdaptationSettings()
    template: str | None = None  # case id; None: the case of smallest mean loss to the others
    groupwise: GroupwiseSettings = GroupwiseSettings()
    shape_model: ShapeModelSettings = ShapeModelSettings()
    evaluation: EvaluationSettings = EvaluationSettings()
    comparison: ComparisonSettings = ComparisonSettings()
    report: ReportSettings = ReportSettings()

    @model_validator(mode="after")
    def _folds_to_retrain(self) -> StudySettings:
        if self.comparison.retrain and self.evaluation.folds < 2:
            raise ValueError(
                "comparison.retrain trains a matcher without each fold, and needs "
                f"evaluation.folds of 2 or more; it is {self.evaluation.folds}. Pass --folds 5, "
                "or set evaluation.folds"
            )
        return self

    @property
    def is_synthetic(self) -> bool:
        return isinstance(self.data, PhantomData)

    def to_yaml(self) -> str:
        content: dict[str, Any] = self.model_dump(mode="json")
        return yaml.safe_dump(content, sort_keys=False, allow_unicode=True)

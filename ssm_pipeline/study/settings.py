"""All settings of a study: one section per stage, each defined in the stage's own package."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import yaml
from pydantic import AfterValidator, Field, model_validator

from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.baselines.s3m.settings import S3MSettings
from ssm_pipeline.baselines.settings import RegistrationSettings
from ssm_pipeline.evaluation.settings import EvaluationSettings
from ssm_pipeline.meshing.settings import MeshingSettings
from ssm_pipeline.methods import comparable_methods, method_named
from ssm_pipeline.report.settings import ReportSettings
from ssm_pipeline.settings import Settings
from ssm_pipeline.shape_model.settings import GroupwiseSettings, ShapeModelSettings
from ssm_pipeline.spectral.settings import SpectralSettings
from ssm_pipeline.study.sources import DataSettings, PhantomData
from ssm_pipeline.training.settings import BUILT_IN_EIGENPAIRS, TrainingSettings

ComparedMethod = Annotated[
    str, AfterValidator(lambda name: method_named(name, comparable_methods()).id)
]


class ComparisonSettings(Settings):
    """The methods that are scored beside the full one, on the same meshes, with the same settings.

    Every method of `ssm_pipeline.methods` can be listed.
    """

    methods: tuple[ComparedMethod, ...] = (
        "without groupwise",
        "network start",
        "without adaptation",
        "adaptation only",
        "nearest point",
        "S3M",
        "S3M tuned",
    )  # the quick methods and the baseline; `workflow benchmark results` compares all of them
    registration: RegistrationSettings = RegistrationSettings()
    s3m: S3MSettings = S3MSettings()
    retrain: bool = False  # also train everything that is learned again without each fold


class StudySettings(Settings):
    """The settings that decide the results.

    The command line sets the device, the processes and the folder.
    """

    description: str = ""  # a line for `workflow list`
    seed: int = Field(0, ge=0, lt=2**32)  # of every random draw
    data: DataSettings
    meshing: MeshingSettings = MeshingSettings()
    spectral: SpectralSettings = SpectralSettings()
    # network: train a network and start adaptation from its poses. none: start from rigid
    # alignment, without training; enough for organs of similar position and shape.
    matching: Literal["network", "none"] = "network"
    training: TrainingSettings = TrainingSettings()
    adaptation: AdaptationSettings = AdaptationSettings()
    template: str | None = None  # case id; None: the case of smallest mean loss to the others
    groupwise: GroupwiseSettings = GroupwiseSettings()
    shape_model: ShapeModelSettings = ShapeModelSettings()
    evaluation: EvaluationSettings = EvaluationSettings()
    comparison: ComparisonSettings = ComparisonSettings()
    report: ReportSettings = ReportSettings()

    @model_validator(mode="after")
    def _phantoms_of_the_same_seed(self) -> StudySettings:
        if isinstance(self.data, PhantomData) and "seed" not in self.data.model_fields_set:
            drawn = self.data.model_copy(update={"seed": self.seed})
            object.__setattr__(self, "data", drawn)
        return self

    @model_validator(mode="after")
    def _folds_to_retrain(self) -> StudySettings:
        if self.comparison.retrain and self.matching == "none":
            raise ValueError(
                "comparison.retrain trains a matcher without each fold, but matching is none, so "
                "there is nothing to train. Remove one of the two settings"
            )
        if self.comparison.retrain and self.evaluation.folds < 2:
            raise ValueError(
                "comparison.retrain trains a matcher without each fold, and needs "
                f"evaluation.folds of 2 or more; it is {self.evaluation.folds}. Pass --folds 5, "
                "or set evaluation.folds"
            )
        return self

    @model_validator(mode="after")
    def _meshes_carry_the_eigenpairs(self) -> StudySettings:
        faces = min(self.meshing.faces, self.training.faces)
        most = (faces // 2 + 2) // 2  # half the vertices of a closed surface without handles
        if self.spectral.eigenpairs > most:
            raise ValueError(
                f"spectral.eigenpairs is {self.spectral.eigenpairs}; surfaces of {faces} triangles "
                f"(the smaller of meshing.faces and training.faces) allow at most {most}. Set "
                "fewer eigenpairs, or more faces"
            )
        return self

    @model_validator(mode="after")
    def _built_in_weights_read_their_eigenpairs(self) -> StudySettings:
        starts = self.matching == "network" and self.training.start == "built-in"
        if starts and self.spectral.eigenpairs != BUILT_IN_EIGENPAIRS:
            raise ValueError(
                f"the built-in weights (training.start) need {BUILT_IN_EIGENPAIRS} eigenpairs, but "
                f"spectral.eigenpairs is {self.spectral.eigenpairs}. Set it to "
                f"{BUILT_IN_EIGENPAIRS}, or set training.start to none"
            )
        return self

    @property
    def is_synthetic(self) -> bool:
        return isinstance(self.data, PhantomData)

    def to_yaml(self) -> str:
        content: dict[str, Any] = self.model_dump(mode="json")
        result: str = yaml.safe_dump(content, sort_keys=False, allow_unicode=True)
        return result

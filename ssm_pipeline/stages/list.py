"""The pipeline: reading this list is reading the pipeline."""

from __future__ import annotations

from ssm_pipeline.comparison.anatomy import evaluation_depends_on
from ssm_pipeline.engine.stage import Stage
from ssm_pipeline.stages.cohort_check import check_meshes
from ssm_pipeline.stages.correspondence import match_cases
from ssm_pipeline.stages.data import data_dependencies, list_cases
from ssm_pipeline.stages.evaluation import evaluate_methods
from ssm_pipeline.stages.groupwise import match_means
from ssm_pipeline.stages.meshing import make_meshes, meshing_dependencies
from ssm_pipeline.stages.report import report_dependencies, write_report
from ssm_pipeline.stages.shape_model import build_model
from ssm_pipeline.stages.spectral import make_bases
from ssm_pipeline.stages.training import train_matcher, what_training_rests_on
from ssm_pipeline.study.settings import StudySettings

STAGES: tuple[Stage[StudySettings], ...] = (
    Stage(
        "data",
        list_cases,
        data_dependencies,
    ),
    Stage("meshing", make_meshes, meshing_dependencies, needs=("data",), version=3),
    Stage("cohort_check", check_meshes, lambda s: {"seed": s.seed}, needs=("meshing",), version=3),
    Stage(
        "spectral",
        make_bases,
        lambda s: {"spectral": s.spectral, "training_faces": s.training.faces},
        needs=("meshing",),
        version=2,
    ),
    Stage(
        "training",
        train_matcher,
        what_training_rests_on,
        needs=("spectral",),
        version=2,
        per_case=False,
    ),
    Stage(
        "correspondence",
        match_cases,
        lambda s: {
            "adaptation": s.adaptation,
            "template": s.template,
            "paths": s.report.paths,
            "seed": s.seed,
        },
        needs=("spectral", "training"),
        version=7,
    ),
    Stage(
        "groupwise",
        match_means,
        lambda s: {"groupwise": s.groupwise, "adaptation": s.adaptation, "seed": s.seed},
        needs=("meshing", "spectral", "correspondence"),
        version=2,
    ),
    Stage("shape_model", build_model, lambda s: s.shape_model, needs=("groupwise",), version=3),
    Stage(
        "evaluation",
        evaluate_methods,
        evaluation_depends_on,
        needs=(
            "meshing",
            "cohort_check",
            "spectral",
            "training",
            "correspondence",
            "groupwise",
            "shape_model",
        ),
        version=4,
    ),
    Stage(
        "report",
        write_report,
        report_dependencies,
        needs=(
            "data",
            "meshing",
            "cohort_check",
            "training",
            "correspondence",
            "groupwise",
            "shape_model",
            "evaluation",
        ),
    ),
)

"""From CT or MR segmentation masks, or surfaces, to a statistical shape model.

>>> import ssm_pipeline as ssm
>>> mesh = ssm.read_mesh("liver.stl")  # doctest: +SKIP

Every public name is imported when it is first used. Importing the package is therefore instant, and
PyTorch is imported only by functions that need it. All coordinates are LPS in millimetres.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ssm_pipeline.adaptation.settings import AdaptationSettings
    from ssm_pipeline.data_prep.formats.surface_files import read_mesh
    from ssm_pipeline.evaluation.settings import EvaluationSettings
    from ssm_pipeline.fitting.patient import FitReport
    from ssm_pipeline.interpolation.settings import InterpolationSettings, SpatialLossSettings
    from ssm_pipeline.library.evaluate_shapes import compare_methods, evaluate
    from ssm_pipeline.library.fit_surface import fit
    from ssm_pipeline.library.from_python import run
    from ssm_pipeline.library.in_memory import correspond, match_cohort, train
    from ssm_pipeline.library.masks import mesh_from_mask, read_mask
    from ssm_pipeline.matching.settings import MatchingSettings, SpectralLossWeights
    from ssm_pipeline.meshing.decimation import decimate
    from ssm_pipeline.meshing.settings import MeshingSettings
    from ssm_pipeline.records import (
        CaseError,
        CorrespondedShapes,
        Correspondence,
        DamagedFile,
        Mask,
        Mesh,
        Metrics,
        SpectralBasis,
        StudyError,
    )
    from ssm_pipeline.runs.run import load_run
    from ssm_pipeline.shape_model.build import build_model
    from ssm_pipeline.shape_model.model import ShapeModel, load_model
    from ssm_pipeline.spectral.basis import spectral_basis
    from ssm_pipeline.spectral.settings import SpectralSettings
    from ssm_pipeline.training.matcher import Matcher, load_matcher
    from ssm_pipeline.training.settings import TrainingSettings

    __version__: str

# Public name → the module that defines it.
_HOMES = {
    "AdaptationSettings": "ssm_pipeline.adaptation.settings",
    "CaseError": "ssm_pipeline.records",
    "CorrespondedShapes": "ssm_pipeline.records",
    "Correspondence": "ssm_pipeline.records",
    "DamagedFile": "ssm_pipeline.records",
    "EvaluationSettings": "ssm_pipeline.evaluation.settings",
    "FitReport": "ssm_pipeline.fitting.patient",
    "InterpolationSettings": "ssm_pipeline.interpolation.settings",
    "Mask": "ssm_pipeline.records",
    "Matcher": "ssm_pipeline.training.matcher",
    "MatchingSettings": "ssm_pipeline.matching.settings",
    "Mesh": "ssm_pipeline.records",
    "MeshingSettings": "ssm_pipeline.meshing.settings",
    "Metrics": "ssm_pipeline.records",
    "ShapeModel": "ssm_pipeline.shape_model.model",
    "SpatialLossSettings": "ssm_pipeline.interpolation.settings",
    "SpectralBasis": "ssm_pipeline.records",
    "SpectralLossWeights": "ssm_pipeline.matching.settings",
    "SpectralSettings": "ssm_pipeline.spectral.settings",
    "StudyError": "ssm_pipeline.records",
    "TrainingSettings": "ssm_pipeline.training.settings",
    "build_model": "ssm_pipeline.shape_model.build",
    "compare_methods": "ssm_pipeline.library.evaluate_shapes",
    "correspond": "ssm_pipeline.library.in_memory",
    "decimate": "ssm_pipeline.meshing.decimation",
    "evaluate": "ssm_pipeline.library.evaluate_shapes",
    "fit": "ssm_pipeline.library.fit_surface",
    "load_matcher": "ssm_pipeline.training.matcher",
    "load_model": "ssm_pipeline.shape_model.model",
    "load_run": "ssm_pipeline.runs.run",
    "match_cohort": "ssm_pipeline.library.in_memory",
    "mesh_from_mask": "ssm_pipeline.library.masks",
    "read_mask": "ssm_pipeline.library.masks",
    "read_mesh": "ssm_pipeline.data_prep.formats.surface_files",
    "run": "ssm_pipeline.library.from_python",
    "spectral_basis": "ssm_pipeline.spectral.basis",
    "train": "ssm_pipeline.library.in_memory",
}

__all__ = [
    "AdaptationSettings",
    "CaseError",
    "CorrespondedShapes",
    "Correspondence",
    "DamagedFile",
    "EvaluationSettings",
    "FitReport",
    "InterpolationSettings",
    "Mask",
    "Matcher",
    "MatchingSettings",
    "Mesh",
    "MeshingSettings",
    "Metrics",
    "ShapeModel",
    "SpatialLossSettings",
    "SpectralBasis",
    "SpectralLossWeights",
    "SpectralSettings",
    "StudyError",
    "TrainingSettings",
    "__version__",
    "build_model",
    "compare_methods",
    "correspond",
    "decimate",
    "evaluate",
    "fit",
    "load_matcher",
    "load_model",
    "load_run",
    "match_cohort",
    "mesh_from_mask",
    "read_mask",
    "read_mesh",
    "run",
    "spectral_basis",
    "train",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module("importlib.metadata").version("ssm-pipeline")
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})

"""The records that pass between the packages of the pipeline, checked on construction.

World space is LPS (left, posterior, superior), in millimetres, everywhere.
"""

from ssm_pipeline.records.arguments import (
    require_each,
    require_type,
)
from ssm_pipeline.records.cases import (
    CaseSource,
    Cohort,
    Dropped,
    Mask,
    Surface,
)
from ssm_pipeline.records.errors import (
    CaseError,
    DamagedFile,
    StudyError,
)
from ssm_pipeline.records.shapes import (
    CorrespondedShapes,
    Correspondence,
    Mesh,
    ShapePath,
    SpectralBasis,
    refuse_doubled,
)
from ssm_pipeline.records.truth import (
    KnownPair,
    Metrics,
    PhantomTruth,
    SurfaceLabels,
)

__all__ = [
    "CaseError",
    "CaseSource",
    "Cohort",
    "CorrespondedShapes",
    "Correspondence",
    "DamagedFile",
    "Dropped",
    "KnownPair",
    "Mask",
    "Mesh",
    "Metrics",
    "PhantomTruth",
    "ShapePath",
    "SpectralBasis",
    "StudyError",
    "Surface",
    "SurfaceLabels",
    "refuse_doubled",
    "require_each",
    "require_type",
]

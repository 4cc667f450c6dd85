"""NumPy archive (.npz): the whole model in arrays, for Python and whatever reads NumPy's files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ssm_pipeline import storage
from ssm_pipeline.shape_model.model import ShapeModel

FORMAT_VERSION = 1


def write_npz(model: ShapeModel, path: Path) -> None:
    """mean (V, 3) mm, modes (M, V, 3) orthonormal, variances (M,) mm², faces (F, 3), scores (N, M)
    in standard deviations, case_ids (N,), unit, space and format_version.

    A shape is mean + Σ_m score_m √variance_m mode_m. Opens without `allow_pickle`.
    """
    with storage.written_whole(path) as temporary:
        np.savez_compressed(
            temporary,
            mean=model.mean,
            modes=model.modes,
            variances=model.variances,
            faces=model.faces,
            scores=model.scores,
            case_ids=np.array(model.case_ids, dtype=np.str_),
            unit=np.array("mm"),
            space=np.array("LPS"),
            format_version=np.array(FORMAT_VERSION),
        )

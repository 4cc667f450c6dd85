"""The model's numbers as CSV: for spreadsheets and statistics programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.shape_model.model import ShapeModel


def write_tables(model: ShapeModel, folder: Path) -> list[Path]:
    """scores.csv: a row per case, its scores in standard deviations. modes.csv: a row per mode, its
    variance in mm², its share of the total variance, and the share of all modes up to it.

    Returns:
        The paths written.
    """
    numbers = np.arange(1, model.mode_count + 1)
    scores = pd.DataFrame(model.scores, columns=[f"mode_{number}_sd" for number in numbers])
    scores.insert(0, "case_id", list(model.case_ids))
    modes = pd.DataFrame(
        {
            "mode": numbers,
            "variance_mm2": model.variances,
            "share": model.variances / model.variances.sum(),
            "cumulative_share": model.compactness,
        }
    )
    written = []
    for name, table in (("scores", scores), ("modes", modes)):
        written.append(folder / f"{name}.csv")
        storage.write_table(table, written[-1])
    return written

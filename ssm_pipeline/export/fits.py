"""Fitted patients as files: a table, and surfaces that open over the scan."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from ssm_pipeline import storage
from ssm_pipeline.export.meshes import write_ply
from ssm_pipeline.export.vtp import write_poly_data
from ssm_pipeline.fitting.patient import FitReport
from ssm_pipeline.fitting.pose_search import mirrored
from ssm_pipeline.records import Dropped, Mesh


def summary(fits: Sequence[FitReport], left_out: Sequence[Dropped] = ()) -> pd.DataFrame:
    """A row per patient: how well it is fitted, how unusual it is, and why it is flagged.

    Patients that could not be fitted come last, with the reason in `left_out` and no numbers.
    """
    rows = []
    for fit in fits:
        judged = fit.typicality
        rows.append(
            {
                "case_id": fit.case_id,
                "by": fit.by,
                "mean_mm": fit.mean_mm,
                "hd95_mm": fit.hd95_mm,
                "observed_percent": 100 * fit.observed_share,
                "noise_mm": fit.noise_mm,
                "residual_mm": judged.residual.value,
                "residual_threshold_mm": judged.residual.threshold,
                "residual_tail": judged.residual.tail,
                "mahalanobis_sd": judged.mahalanobis.value,
                "mahalanobis_threshold_sd": judged.mahalanobis.threshold,
                "mahalanobis_tail": judged.mahalanobis.tail,
                "turned_deg": judged.turned_deg,
                "turned_threshold_deg": judged.turned_threshold_deg,
                "mirror_ratio": judged.mirror_ratio,
                "flagged": judged.is_flagged,
                "flags": " | ".join(judged.flags),
                "remarks": " | ".join(fit.remarks),
                "left_out": "",
            }
        )
    rows += [{"case_id": case.case_id, "left_out": case.reason} for case in left_out]
    return pd.DataFrame(rows)


def scores_table(fits: Sequence[FitReport]) -> pd.DataFrame:
    """A row per patient and mode: the score in standard deviations and its 95 % interval."""
    return pd.concat(
        [
            pd.DataFrame(
                {
                    "case_id": fit.case_id,
                    "mode": np.arange(1, len(fit.scores) + 1),
                    "score_sd": fit.scores,
                    "low_sd": fit.low,
                    "high_sd": fit.high,
                }
            )
            for fit in fits
        ],
        ignore_index=True,
    )


def mirrored_back(fit: FitReport) -> FitReport:
    """The surfaces of a patient who was read as a mirror image, where the scan has them."""
    back = mirrored(Mesh(fit.vertices, fit.faces, fit.case_id))
    return dataclasses.replace(
        fit, surface=mirrored(fit.surface), vertices=back.vertices, faces=back.faces
    )


def write_fit(fit: FitReport, folder: Path) -> list[Path]:
    """surface.ply and reconstruction.ply; reconstruction.vtp with arrays per vertex: distance_mm
    (−1 where nothing was seen), observed, sd_mm, radius_90_mm. All in the scan's millimetres (LPS).

    Returns:
        The paths written.
    """
    import pyvista

    surface, mesh, mapped = (
        folder / name for name in ("surface.ply", "reconstruction.ply", "reconstruction.vtp")
    )
    write_ply(fit.surface.vertices, fit.surface.faces, surface)
    write_ply(fit.vertices, fit.faces, mesh)
    poly = pyvista.PolyData.from_regular_faces(fit.vertices, fit.faces)
    arrays = {
        "distance_mm": np.where(fit.observed, fit.distances_mm, -1.0),
        "observed": fit.observed,
        "sd_mm": fit.sd_mm,
        "radius_90_mm": fit.radius_mm,
    }
    for name, values in arrays.items():
        poly.point_data[name] = values.astype(np.float32)
    poly.field_data["SPACE"] = ["LPS"]
    poly.field_data["UNIT"] = ["mm"]
    write_poly_data(poly, mapped)
    return [surface, mesh, mapped]


def write_fits(
    fits: Sequence[FitReport],
    folder: Path,
    reflected: bool = False,
    left_out: Sequence[Dropped] = (),
) -> list[Path]:
    """fits.csv, scores.csv, and the files of `write_fit` in a folder per patient.

    Args:
        reflected: The patients were read as mirror images: their surfaces are mirrored back.
        left_out: The patients that could not be fitted, for fits.csv.

    Returns:
        The paths written.
    """
    written = []
    for name, table in (("fits", summary(fits, left_out)), ("scores", scores_table(fits))):
        written.append(folder / f"{name}.csv")
        storage.write_table(table, written[-1])
    for fit in fits:
        written += write_fit(mirrored_back(fit) if reflected else fit, folder / fit.case_id)
    return written

"""The page of new patients: each surface over the model's fit, and whether it can be trusted."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ssm_pipeline import storage
from ssm_pipeline.counting import counted
from ssm_pipeline.fitting.patient import FitReport
from ssm_pipeline.fitting.typicality import Judged
from ssm_pipeline.records import Dropped
from ssm_pipeline.report.case_names import short_names
from ssm_pipeline.report.packing import Block
from ssm_pipeline.report.payload import packed_mesh, plain
from ssm_pipeline.report.rounding import FINE, round_up
from ssm_pipeline.report.settings import ReportSettings
from ssm_pipeline.report.template import fill

AXIS_SD = 4.0  # the modes' axes reach ± this many standard deviations


def write_fit_page(
    fits: Sequence[FitReport],
    path: Path,
    study: str,
    is_synthetic: bool = False,
    settings: ReportSettings | None = None,
    drawn: int = 0,
    left_out: Sequence[Dropped] = (),
) -> None:
    """Write the page of one or more fitted patients to `path` (.html), whole or not at all.

    Args:
        drawn: How many shapes of the model stood in for its cases, too few for a judgement.
        left_out: The patients that could not be fitted, each with the reason.
    """
    html = fit_html(fits, study, is_synthetic, settings or ReportSettings(), drawn, left_out)
    storage.write_text(path, html)


def fit_html(
    fits: Sequence[FitReport],
    study: str,
    is_synthetic: bool,
    settings: ReportSettings,
    drawn: int = 0,
    left_out: Sequence[Dropped] = (),
) -> str:
    """The page's text. Everything is inside: it opens from a folder without a server."""
    if not fits:
        raise ValueError("no fitted patient to show")
    names = short_names([fit.case_id for fit in fits])
    block = Block()
    faces = block.add_indices(fits[0].faces)
    patients = [_patient(fit, names[fit.case_id], settings, block) for fit in fits]
    cohort_ids = fits[0].cohort_ids
    cohort_names = short_names(cohort_ids)
    modes = min(settings.modes, len(fits[0].scores))
    # A shape unlike the model's cases would stretch the colour range for all others.
    like = [fit for fit in fits if not fit.typicality.is_flagged] or fits
    description = {
        "study": study,
        "faces": faces,
        "patients": patients,
        "axisSd": AXIS_SD,
        "rangeMm": {
            "residual": _range_mm([fit.distances_mm[fit.observed] for fit in like]),
            "radius": _range_mm([fit.radius_mm for fit in like]),
        },
        "cohort": {
            "names": [cohort_names[case_id] for case_id in cohort_ids],
            "scores": np.round(fits[0].cohort_scores[:, :modes], 3).tolist(),
        },
    }
    tabs = [("fit", "Patient")] + [("patients", "All patients")] * (len(fits) > 1 or bool(left_out))
    return fill(
        "fit.html",
        plain(description),
        {"block-fit": block.base64()},
        tabs=tabs,
        study=study,
        is_synthetic=is_synthetic,
        patients=patients,
        left_out=left_out,
        beside=(
            f"Compared with {counted(drawn, 'shape')} drawn from the model, because it has too few "
            "cases. Drawn shapes vary less than patients: limits and intervals are too narrow"
            if drawn
            else f"Compared with the model's {counted(len(cohort_ids), 'case')}, each fitted by a "
            "model without it"
        ),
    )


def _patient(fit: FitReport, name: str, settings: ReportSettings, block: Block) -> dict[str, Any]:
    """What the viewer and the tables show of one patient; positions about the fit's centre."""
    centre = fit.vertices.mean(axis=0)
    modes = min(settings.modes, len(fit.scores))
    typicality = fit.typicality
    return {
        "id": name,
        "wholeId": fit.case_id,
        "by": fit.by,
        "points": block.add_numbers(fit.vertices - centre),
        "residual": block.add_numbers(np.where(fit.observed, fit.distances_mm, 0.0)),
        "radius": block.add_numbers(fit.radius_mm),
        "observed": None if fit.observed.all() else block.add_indices(fit.observed.astype(int)),
        "mesh": packed_mesh(
            fit.surface.vertices - centre, fit.surface.faces, settings.case_faces, block
        ),
        "scores": fit.scores[:modes].tolist(),
        "low": fit.low[:modes].tolist(),
        "high": fit.high[:modes].tolist(),
        "flags": list(typicality.flags),
        "remarks": list(fit.remarks),
        "meanMm": f"{fit.mean_mm:.2f}",
        "hd95Mm": f"{fit.hd95_mm:.2f}",
        "observedPercent": f"{100 * fit.observed_share:.0f}",
        "radiusMm": f"{np.median(fit.radius_mm):.2f}",
        "judged": [
            _judged("Distance patient–model, used for the flag", "mm", 2, typicality.residual),
            _judged("Mahalanobis distance", "SD", 1, typicality.mahalanobis),
            {
                "name": "Rotated by",
                "value": f"{typicality.turned_deg:.0f}°",
                "threshold": f"{typicality.turned_threshold_deg:.0f}°",
                "tail": "",
                "isFlagged": typicality.turned_deg > typicality.turned_threshold_deg,
            },
        ],
    }


def _judged(name: str, unit: str, digits: int, judged: Judged) -> dict[str, Any]:
    return {
        "name": name,
        "value": f"{judged.value:.{digits}f} {unit}",
        "number": f"{judged.value:.{digits}f}",
        "unit": unit,
        "tailPercent": f"{100 * judged.tail:.6g}",
        "threshold": f"{judged.threshold:.{digits}f} {unit}",
        "tail": "< 0.1 %" if judged.tail < 0.001 else f"{100 * judged.tail:.1f} %",
        "isFlagged": judged.is_flagged,
    }


def _range_mm(values: Sequence[np.ndarray]) -> float:
    """A round number of millimetres that 98 % of the vertices stay below."""
    return round_up(max(float(np.percentile(np.concatenate(values), 98)), 1e-3), FINE)

"""Settings of the report page and of the static figures."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from ssm_pipeline.settings import Settings


class FigureSettings(Settings):
    """Static figures, in the sizes journals ask for (one column about 88 mm, two about 180 mm)."""

    width_mm: float = Field(180.0, gt=20)  # full text width, mm
    font: str = "Arial"  # falls back to Liberation Sans and DejaVu Sans where not installed
    font_size_pt: float = Field(8.0, ge=5)  # points, at the printed size
    dpi: int = Field(300, ge=50)  # dots per inch of the renders and of PNG files
    format: Literal["pdf", "png"] = "pdf"  # PDF keeps text and curves as vectors, fonts embedded
    modes: int = Field(5, ge=1)  # modes drawn in the mode figure
    deviations: float = Field(2.0, gt=0)  # standard deviations either side of the mean
    interpolation_steps: int = Field(6, ge=2)  # frames of an interpolation strip
    correspondence_cases: int = Field(8, ge=1)  # cases drawn in the correspondence figure


class ReportSettings(Settings):
    """The report page. The defaults keep 22 cases of 4000 vertices well under 15 MB."""

    modes: int = Field(10, ge=1)  # modes with a slider on the page
    slider_range: float = Field(3.0, gt=0)  # sliders reach ± this many standard deviations
    case_faces: int = Field(4000, ge=100)  # triangles of each case's own surface on the page
    paths: int = Field(4, ge=0)  # interpolation paths on the page
    path_times: int = Field(11, ge=2)  # stored times of each path; linear in between
    tile_px: int = Field(280, ge=64)  # side of the static pictures on the page, pixels
    landmarks: Path | None = None  # Slicer's .mrk.json or .fcsv, placed on the template; None: none
    figures: FigureSettings = FigureSettings()

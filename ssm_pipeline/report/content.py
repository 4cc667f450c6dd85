"""What the report shows: everything the page and the figures need, and nothing to recompute."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from ssm_pipeline.data_prep.formats.landmarks import Landmarks
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records import CorrespondedShapes, Mesh, ShapePath
from ssm_pipeline.report.case_names import short_names
from ssm_pipeline.shape_model.model import ShapeModel
from ssm_pipeline.statistics.compare import ShapeComparison

_NEEDED_COLUMNS = {
    "compactness": {"modes", "share"},
    "generalisation": {"modes", "case_id", "chamfer_mm"},
    "specificity": {"modes", "chamfer_mm"},
}


@dataclass(frozen=True, eq=False)
class ReportContent:
    """One study's results, as the report stage hands them over.

    Attributes:
        aligned: The corresponded shapes in the model's frame, mm; case ids as in `model`.
        frames: Per case of `aligned`, from its own millimetres to the model's frame.
        meshes: Each case's own surface, already in the model's frame, mm.
        paths: Interpolations template → case, a few of them.
        correspondence: case_id, surface_mm, hd95_mm, flipped_percent: the template mapped to the
            case, before any PCA. More columns are shown as they are.
        metrics: Tables by name: compactness (modes, share), generalisation (modes, case_id,
            chamfer_mm, … a row per held-out case), specificity (modes, chamfer_mm, chamfer_se_mm,
            …), comparison (a row per method). `method` separates curves. Missing tables are left
            out of the page, which says so.
        cohort: case_id and quality control columns, units in the names; `dropped` holds the reason
            for cases left out (empty otherwise), `warnings` any remarks.
        stages: One mapping per stage: name, seconds (None: reused from an earlier run),
            peak_memory_mb, cases_in, cases_out.
        training: A row per step: step, total, one column per loss, and what was watched of the map
            (map_extent, map_sharpness, mean_cosine, share_hit). None: no curves.
        check: case_id, robust z-scores (`…_z`) and remarks of the cohort check; check_pictures case
            id → PNG. None, empty: not shown.
        copies: As `Run.copies`. patients_advice: a sentence on ids that look like one patient's.
        settings, versions: Nested mappings of plain values, shown as they are.

    Raises:
        ValueError: Where the parts don't belong together.
    """

    study: str
    is_synthetic: bool
    model: ShapeModel
    aligned: CorrespondedShapes
    frames: tuple[Similarity, ...]
    meshes: tuple[Mesh, ...]
    paths: tuple[ShapePath, ...]
    correspondence: pd.DataFrame
    metrics: Mapping[str, pd.DataFrame]
    cohort: pd.DataFrame
    stages: tuple[Mapping[str, Any], ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    seed: int = 0
    landmarks: Landmarks | None = None
    training: pd.DataFrame | None = None
    check: pd.DataFrame | None = None
    check_pictures: Mapping[str, bytes] = field(default_factory=dict)
    copies: pd.DataFrame | None = None
    patients_advice: str = ""
    comparisons: tuple[ShapeComparison, ...] = ()

    @property
    def has_network(self) -> bool:
        """Whether the study matches with a network."""
        return self.settings.get("matching") != "none"

    def __post_init__(self) -> None:
        case_ids = self.aligned.case_ids
        if self.model.case_ids != case_ids:
            raise ValueError("the model and the aligned shapes name different cases")
        if len(self.frames) != len(case_ids):
            raise ValueError(f"{len(self.frames)} frames for {len(case_ids)} aligned shapes")
        strangers = {mesh.case_id for mesh in self.meshes} - set(case_ids)
        if strangers:
            raise ValueError(f"meshes of cases that the model does not hold: {sorted(strangers)}")
        _require("correspondence", self.correspondence, {"case_id", "surface_mm", "hd95_mm"})
        _require("cohort", self.cohort, {"case_id"})
        if self.check is not None:
            _require("cohort_check", self.check, {"case_id", "remarks"})
        for name, needed in _NEEDED_COLUMNS.items():
            if name in self.metrics:
                _require(name, self.metrics[name], needed)
        if self.landmarks is not None and self.aligned.template_id not in case_ids:
            raise ValueError(
                f"landmarks lie on template {self.aligned.template_id}, which is not among the "
                "aligned cases: they can't be mapped to the cases"
            )

    @property
    def names(self) -> dict[str, str]:
        """Case id → what the page calls it."""
        ids = {*self.aligned.case_ids, self.aligned.template_id}
        ids |= {case_id for path in self.paths for case_id in (path.template_id, path.case_id)}
        tables = [self.cohort, *([] if self.check is None else [self.check])]
        ids |= {str(case_id) for table in tables for case_id in table["case_id"]}
        if self.copies is not None:
            ids |= {str(one) for name in ("case_id", "copy_of") for one in self.copies[name]}
        return short_names(sorted(ids))

    @property
    def template_index(self) -> int | None:
        """Position of the template among the cases; None where it is not one of them."""
        ids = self.aligned.case_ids
        return ids.index(self.aligned.template_id) if self.aligned.template_id in ids else None

    @property
    def template_vertices(self) -> np.ndarray:
        """(V, 3) mm: the template in the model's frame, or the mean where it is not a case."""
        index = self.template_index
        return self.model.mean if index is None else self.aligned.vertices[index]

    def mesh_of(self, case_id: str) -> Mesh | None:
        return next((mesh for mesh in self.meshes if mesh.case_id == case_id), None)


def _require(name: str, table: pd.DataFrame, needed: set[str]) -> None:
    missing = sorted(needed - set(table.columns))
    if missing:
        raise ValueError(
            f"table {name} lacks column(s) {', '.join(missing)}; it has "
            f"{', '.join(map(str, table.columns))}"
        )

"""What the page's viewer reads: one JSON description and a few binary blocks."""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass
from typing import Any

import fast_simplification
import numpy as np
import pandas as pd

from ssm_pipeline.export.glb import glb_bytes
from ssm_pipeline.records import ShapePath
from ssm_pipeline.report.comparisons import comparison_description
from ssm_pipeline.report.content import ReportContent
from ssm_pipeline.report.curves import DISTANCES, distances_in, quality_curves
from ssm_pipeline.report.distortion_charts import distortion_charts
from ssm_pipeline.report.grid_pattern import grid_spacing_mm
from ssm_pipeline.report.landmarks import carry_landmarks
from ssm_pipeline.report.method_table import method_traits
from ssm_pipeline.report.packing import Block
from ssm_pipeline.report.pictures import mode_range_mm
from ssm_pipeline.report.settings import ReportSettings
from ssm_pipeline.report.training_curves import training_charts


@dataclass(frozen=True)
class Payload:
    """description: plain values for JSON; blocks: base64 text by element id."""

    description: dict[str, Any]
    blocks: dict[str, str]


def build_payload(content: ReportContent, settings: ReportSettings) -> Payload:
    model = content.model
    modes = min(settings.modes, model.mode_count)
    cases_block = Block()
    cases = _cases(content, settings, cases_block, modes)
    template_points = cases_block.add_numbers(content.template_vertices)
    blocks = {
        # The same file that `export` writes: the page has no second copy of the model.
        "block-model": base64.b64encode(glb_bytes(model, modes)).decode(),
        "block-cases": cases_block.base64(),
    }
    paths = []
    for number, path in enumerate(content.paths[: settings.paths]):
        block = Block()
        ends = {
            "template": content.names[path.template_id],
            "case": content.names[path.case_id],
        }
        paths.append(ends | _path(path, settings, block) | {"block": f"block-path-{number}"})
        blocks[f"block-path-{number}"] = block.base64()
    description = {
        "study": content.study,
        "isSynthetic": content.is_synthetic,
        "share": (model.variances / model.variances.sum()).tolist(),
        "sliderRange": settings.slider_range,
        "colourRangeMm": mode_range_mm(model, modes, settings.figures.deviations),
        "cases": cases,
        "paths": paths,
        "template": {
            "id": content.names[content.aligned.template_id],
            "wholeId": content.aligned.template_id,
            "isCase": content.template_index is not None,
            "points": template_points,
            "gridMm": grid_spacing_mm(content.template_vertices),
        },
        "landmarks": list(content.landmarks.names) if content.landmarks else [],
        "curves": _curves(content),
        "methods": {
            method: {"network": network, "sawCase": saw}
            for method, (network, saw) in method_traits(
                content.metrics, content.has_network
            ).items()
        },
        "training": training_charts(content.training),
        "distortion": distortion_charts(content),
    }
    if content.comparisons:
        block = Block()
        description["compare"] = comparison_description(
            content.comparisons, model, content.names, settings, block
        )
        blocks["block-compare"] = block.base64()
    return Payload(plain(description), blocks)


def _cases(
    content: ReportContent, settings: ReportSettings, block: Block, modes: int
) -> list[dict[str, Any]]:
    model, aligned = content.model, content.aligned
    quality = content.correspondence.set_index("case_id")
    errors = np.linalg.norm(model.reconstruct(model.scores[:, :modes]) - aligned.vertices, axis=2)
    landmarks = _landmarks(content)
    cases, names = [], content.names
    for index, case_id in enumerate(aligned.case_ids):
        mesh = content.mesh_of(case_id)
        cases.append(
            {
                "id": names[case_id],
                "wholeId": case_id,
                "scores": model.scores[index, :modes].tolist(),
                "reconstructionMm": float(errors[index].mean()),
                "fit": quality.loc[case_id].to_dict() if case_id in quality.index else {},
                "points": block.add_numbers(aligned.vertices[index]),
                "mesh": None
                if mesh is None
                else packed_mesh(mesh.vertices, mesh.faces, settings.case_faces, block),
                "landmarks": [] if landmarks is None else landmarks[index].tolist(),
            }
        )
    return cases


def _landmarks(content: ReportContent) -> np.ndarray | None:
    """(N, L, 3) mm in the model's frame, or None without landmarks."""
    index = content.template_index
    if content.landmarks is None or index is None:
        return None
    aligned = content.aligned
    on_template = content.frames[index].apply(content.landmarks.positions)
    return carry_landmarks(on_template, aligned.vertices[index], aligned.faces, aligned.vertices)


def packed_mesh(
    vertices: np.ndarray, faces: np.ndarray, face_count: int, block: Block
) -> dict[str, Any]:
    """A surface in millimetres, thinned to `face_count` triangles where it has more."""
    if len(faces) > face_count:
        vertices, faces = fast_simplification.simplify(
            np.ascontiguousarray(vertices, dtype=np.float32),
            np.ascontiguousarray(faces, dtype=np.int32),
            target_count=face_count,
        )
    return {"points": block.add_numbers(vertices), "faces": block.add_indices(faces)}


def _path(path: ShapePath, settings: ReportSettings, block: Block) -> dict[str, Any]:
    times = np.linspace(0, 1, min(settings.path_times, len(path.times)))
    pose = np.stack([path.at(float(t), 0) for t in times])
    offsets = np.stack([path.at(float(t), 1) for t in times]) - pose
    # Each frame is centred: two scans lie anywhere in their scanners, and the page looks at shape.
    pose -= pose.mean(axis=1, keepdims=True)
    offsets -= offsets.mean(axis=1, keepdims=True)
    return {
        "times": times.tolist(),
        "pose": block.add_numbers(pose),
        "offsets": block.add_numbers(offsets),
        "faces": block.add_indices(path.faces),
    }


def _curves(content: ReportContent) -> dict[str, Any]:
    """chart → distance → lines (method, modes, value, se)."""
    charts: dict[str, Any] = {"compactness": {}, "generalisation": {}, "specificity": {}}
    for distance in distances_in(content.metrics) or ["chamfer_mm"]:
        for name, table in quality_curves(content.metrics, distance).items():
            charts[name][distance] = [
                {
                    "method": str(method),
                    "modes": line["modes"].tolist(),
                    "value": line["value"].tolist(),
                    "se": line["se"].tolist(),
                }
                for method, line in table.groupby("method", sort=False)
            ]
    return {"charts": charts, "distances": DISTANCES}


def plain(value: Any) -> Any:
    """Values that JSON knows: no NaN, no NumPy scalars."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if value is pd.NA or (isinstance(value, float) and not math.isfinite(value)):
        return None
    return value

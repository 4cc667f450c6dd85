"""A small made-up study for the tests of the report: lung-like blobs with known deformations."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.spatial import ConvexHull

from ssm_pipeline.geometry import surface
from ssm_pipeline.records import CorrespondedShapes, Mesh, ShapePath
from ssm_pipeline.report.content import ReportContent
from ssm_pipeline.report.landmarks import Landmarks
from ssm_pipeline.shape_model import alignment, pca


def even_sphere(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Fibonacci points on the unit sphere and their outward triangles."""
    i = np.arange(count) + 0.5
    polar, azimuth = np.arccos(1 - 2 * i / count), np.pi * (1 + 5**0.5) * i
    points = np.stack(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=1
    )
    faces = ConvexHull(points).simplices.astype(np.int64)
    a, b, c = (points[faces[:, k]] for k in range(3))
    inward = np.einsum("fd,fd->f", np.cross(b - a, c - a), a) < 0
    faces[inward] = faces[inward][:, ::-1]
    return points, faces


def blob(directions: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """A left-lung-like solid in mm: apex, base, cardiac notch; `scores` drive five changes."""
    x, y, z = directions.T
    breath, width, lean, notch, tilt = scores
    taper = 1 - 0.28 * z
    notch_depth = (14 + 5 * notch) * np.exp(-(((x + 0.9) / 0.5) ** 2 + (z + 0.2) ** 2 / 0.2))
    points = np.stack(
        [
            48 * x * taper + notch_depth + 7 * lean * np.maximum(z, 0) ** 2,
            (68 + 6 * width) * y * taper,
            (112 + (9 * breath + 5 * tilt * y) * (z < 0)) * z,
        ],
        axis=1,
    )
    # The diaphragm pushes the base up.
    points[:, 2] += 30 * np.exp(-(x**2 + y**2) / 0.35) * (z < 0) * np.abs(z)
    return points


def make_content(
    vertex_count: int = 500, case_count: int = 8, path_count: int = 2, seed: int = 3
) -> ReportContent:
    generator = np.random.default_rng(seed)
    directions, faces = even_sphere(vertex_count)
    scores = generator.standard_normal((case_count, 5))
    shapes = np.stack([blob(directions, s) for s in scores])
    # A little of every direction, so that the model holds N − 1 modes as real data does.
    bumps = generator.standard_normal((case_count, 3, 3, 3)) * 1.5
    waves = np.sin(directions @ generator.standard_normal((3, 3)) * 2)
    shapes += np.einsum("vw,nwde,ve->nvd", waves, bumps, directions)
    ids = tuple(f"blob.{n:03d}" for n in range(case_count))
    own = CorrespondedShapes(shapes, faces, ids, ids[0])
    aligned, frames = alignment.align(own)
    model = pca.build(aligned)
    meshes = tuple(
        Mesh(v + 0.4 * generator.standard_normal(v.shape), faces, case)
        for v, case in zip(aligned.vertices, ids, strict=True)
    )
    times = np.linspace(0, 1, 11)
    paths = []
    for target in range(1, 1 + path_count):
        turn = 0.3 * np.sin(np.pi * times)[:, None]
        move = shapes[target] - shapes[0]
        pose = shapes[0] + times[:, None, None] * move * 0.7
        pose[..., 0] += 10 * turn * pose[..., 2] / 100
        offsets = times[:, None, None] * move * 0.3
        paths.append(ShapePath(ids[0], ids[target], times, pose, offsets, faces))
    return ReportContent(
        study="blobs",
        is_synthetic=True,
        model=model,
        aligned=aligned,
        frames=frames,
        meshes=meshes,
        paths=tuple(paths),
        correspondence=pd.DataFrame(
            {
                "case_id": ids,
                "surface_mm": generator.uniform(0.3, 1.2, case_count),
                "hd95_mm": generator.uniform(1.0, 3.0, case_count),
                "flipped_percent": generator.uniform(0, 0.5, case_count),
            }
        ),
        metrics=_metrics(model.compactness, ids, generator),
        cohort=pd.DataFrame(
            {
                "case_id": [*ids, "blob.bad"],
                "volume_ml": [*(surface.volume(v, faces) / 1e3 for v in shapes), np.nan],
                "area_cm2": [*(surface.area(v, faces) / 1e2 for v in shapes), np.nan],
                "euler_number": [*([2.0] * case_count), np.nan],
                "min_angle_deg": [*generator.uniform(8, 20, case_count), np.nan],
                "warnings": ["touches the border <1 slice>", *[""] * case_count],
                "dropped": [""] * case_count + ["3 boundary loops; a closed surface is needed"],
            }
        ),
        stages=(
            {
                "name": "meshing",
                "seconds": 31.4,
                "peak_memory_mb": 812.0,
                "cases_in": 9,
                "cases_out": case_count,
            },
            {
                "name": "spectral",
                "seconds": 12.0,
                "peak_memory_mb": 640.5,
                "cases_in": case_count,
                "cases_out": case_count,
            },
        ),
        settings={"meshing": {"faces": 2 * vertex_count - 4, "smoothing_mm": 2.0}, "seed": seed},
        versions={"ssm-pipeline": "0.1.0", "numpy": np.__version__},
        seed=seed,
        landmarks=Landmarks(("apex", "base"), shapes[0][[0, vertex_count - 1]]),
    )


def _metrics(
    compactness: np.ndarray, ids: tuple[str, ...], generator: np.random.Generator
) -> dict[str, pd.DataFrame]:
    modes = np.arange(1, len(compactness) + 1)
    generalisation = [
        {
            "method": method,
            "case_id": case,
            "modes": m,
            "chamfer_mm": level + 3 / m + generator.normal(0, 0.3),
            "surface_mm": level / 2 + 2 / m,
            "correspondence_mm": level + 4 / m,
            "chamfer_floor_mm": 1.25,
            "points": 500,
        }
        for method, level in (("ours", 1.5), ("s3m", 2.0))
        for case in ids
        for m in modes
    ]
    specificity = [
        {
            "method": method,
            "modes": m,
            "chamfer_mm": level + 0.1 * m,
            "chamfer_se_mm": 0.03,
            "samples": 1000,
            "seed": 0,
        }
        for method, level in (("ours", 4.0), ("s3m", 5.0))
        for m in modes
    ]
    return {
        "compactness": pd.DataFrame({"method": "ours", "modes": modes, "share": compactness}),
        "generalisation": pd.DataFrame(generalisation),
        "specificity": pd.DataFrame(specificity),
        "comparison": pd.DataFrame(
            {
                "method": ["ours", "s3m"],
                "generalisation_chamfer_mm": [2.1, 2.6],
                "generalisation_chamfer_se_mm": [0.08, 0.1],
            }
        ),
    }

"""Made-up studies for the tests of the report: lung-like blobs with known deformations."""

from __future__ import annotations

import dataclasses
import io
import zlib

import numpy as np
import pandas as pd
from PIL import Image
from scipy.spatial import ConvexHull

from ssm_pipeline.data_prep.formats.landmarks import Landmarks
from ssm_pipeline.fitting.patient import FitReport
from ssm_pipeline.fitting.typicality import Judged, Typicality
from ssm_pipeline.geometry import surface
from ssm_pipeline.geometry.similarity import Similarity
from ssm_pipeline.records import CorrespondedShapes, Mesh, ShapePath
from ssm_pipeline.report.content import ReportContent
from ssm_pipeline.shape_model import alignment
from ssm_pipeline.shape_model.pca import pca_model
from ssm_pipeline.statistics.compare import ShapeComparison, VertexMap
from ssm_pipeline.statistics.covariates import Column, Design


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
    model = pca_model(aligned)
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


# Method, level of generalisation and specificity in mm, whether it uses a network.
COHORT_METHODS = (
    ("full", 1.06, 2.31, True),
    ("without groupwise", 1.07, 2.32, True),
    ("without adaptation", 1.55, 2.75, True),
    ("spectral only", 1.83, 2.91, True),
    ("adaptation only", 1.07, 2.29, False),
    ("adaptation only, groupwise", 1.06, 2.31, False),
    ("nearest point", 1.41, 2.52, False),
    ("affine nearest", 1.38, 2.50, False),
    ("affine nearest, groupwise", 1.35, 2.48, False),
    ("nricp", 1.12, 2.37, False),
    ("bcpd", 1.17, 2.42, False),
    ("bcpd, groupwise", 1.16, 2.41, False),
    ("S3M", 1.71, 3.22, True),
    ("S3M tuned", 1.52, 3.01, True),
)


def make_cohort(vertex_count: int = 600, case_count: int = 29, seed: int = 5) -> ReportContent:
    """As large a report as real cohorts give: ids of 64 characters, 14 methods, every table."""
    content = make_content(vertex_count, case_count, 4, seed)
    generator = np.random.default_rng(seed)
    digits = generator.integers(10, size=(case_count + 2, 33))
    ids = [f"1.3.6.1.4.1.14519.5.2.1.6279.6001.{''.join(map(str, row))}" for row in digits][:-2]
    ids = [case_id[:64] for case_id in ids]
    new = dict(zip(content.aligned.case_ids, ids, strict=True))
    cohort = content.cohort.assign(
        case_id=[
            new.get(case_id, f"1.3.6.1.4.1.14519.{'9' * 40}")
            for case_id in content.cohort["case_id"]
        ],
        faces=8000,
        boundary_loops=0,
        handles_cut=generator.integers(0, 3, case_count + 1),
        voxel_mm=1.5,
        smoothing_mm=2.0,
        mask_volume_ml=lambda table: table["volume_ml"] * 1.00001,
        volume_change_percent=generator.normal(0, 1e-5, case_count + 1),
        surface_mean_mm=generator.uniform(0.3, 0.5, case_count + 1),
        surface_hd95_mm=generator.uniform(0.9, 1.4, case_count + 1),
    )
    fits = content.correspondence.assign(
        case_id=ids,
        to_case_mm=1e-15 * generator.uniform(1, 3, case_count),
        to_case_hd95_mm=3e-15 * generator.uniform(1, 3, case_count),
        from_case_mm=lambda table: 2 * table["surface_mm"],
        from_case_hd95_mm=lambda table: table["hd95_mm"],
        uncovered_percent=generator.uniform(0, 0.4, case_count),
        coverage_mm=11.3,
        distinct_percent=generator.uniform(70, 90, case_count),
        round_trip_mm=generator.uniform(1, 2, case_count),
    )
    paths = tuple(
        dataclasses.replace(path, template_id=ids[0], case_id=new[path.case_id])
        for path in content.paths
    )
    check, pictures = _check(ids, generator)
    return dataclasses.replace(
        content,
        study="lungs",
        is_synthetic=False,
        model=dataclasses.replace(content.model, case_ids=tuple(ids)),
        aligned=dataclasses.replace(content.aligned, case_ids=tuple(ids), template_id=ids[0]),
        meshes=tuple(dataclasses.replace(m, case_id=new[m.case_id]) for m in content.meshes),
        paths=paths,
        correspondence=fits,
        metrics=_cohort_metrics(
            content.model.compactness, ids, [p.case_id for p in paths], generator
        ),
        cohort=cohort,
        training=_losses(400, generator),
        check=check,
        check_pictures=pictures,
    )


def _cohort_metrics(
    compactness: np.ndarray, ids: list[str], path_cases: list[str], generator: np.random.Generator
) -> dict[str, pd.DataFrame]:
    modes = np.unique(np.linspace(1, len(compactness), 24).round().astype(int))
    spread = generator.normal(0, 0.15, len(ids))
    compact, general, specific, rows = [], [], [], []
    for method, level, drawn, network in COHORT_METHODS:
        own = generator.normal(0, 0.02, len(ids)) if method != "full" else np.zeros(len(ids))
        for m in modes:
            compact.append(
                {"method": method, "modes": m, "share": compactness[m - 1] ** (level / 1.06)}
            )
            specific.append(
                {"method": method, "modes": m, "chamfer_mm": drawn + 2 + 0.01 * m,
                 "chamfer_se_mm": 0.03, "surface_mm": drawn + 0.01 * m, "surface_se_mm": 0.05,
                 "hd95_mm": 2.4 * drawn, "hd95_se_mm": 0.1, "samples": 1000, "surface_samples": 100,
                 "chamfer_floor_mm": 1.93, "points": 4000, "seed": 0}
            )  # fmt: skip
            general += [
                {"method": method, "matching_saw_case": network or "groupwise" in method,
                 "case_id": case, "modes": m, "chamfer_mm": 1.6 + level + 2 / m + s + o,
                 "surface_mm": level + 2 / m + s + o, "hd95_mm": 2.2 * level + 4 / m,
                 "correspondence_mm": 2 * level + 4 / m, "chamfer_floor_mm": 1.93, "points": 4000}
                for case, s, o in zip(ids, spread, own, strict=True)
            ]  # fmt: skip
        row = {
            "method": method, "modes": modes[-1], "cases": len(ids), "points": 4000,
            "uses_network": network, "variance_percent": 99.2 - level,
        }  # fmt: skip
        for name, value, full, error in (
            ("generalisation", level, 1.06, 0.03),
            ("unseen_generalisation", 1.04 * level, 1.04 * 1.06, 0.04),
            ("specificity", drawn, 2.31, 0.05),
        ):
            difference = value - full + generator.normal(0, 0.004)
            row |= {
                f"{name}_surface_mm": value + 0.07, f"{name}_surface_se_mm": error,
                f"{name}_surface_difference_mm": difference,
                f"{name}_surface_low_mm": difference - 1.3 * error,
                f"{name}_surface_high_mm": difference + 1.3 * error,
                f"{name}_surface_p": float(np.exp(-((difference / error) ** 2) * 1.3)),
            }  # fmt: skip
            if not name.startswith("unseen"):
                row |= {
                    f"{name}_chamfer_mm": value + 1.7, f"{name}_chamfer_se_mm": error,
                    f"{name}_hd95_mm": 2.3 * value, f"{name}_hd95_se_mm": 2 * error,
                }  # fmt: skip
        if method == "full":
            row |= dict.fromkeys(
                [key for key in row if "difference" in key or "_low" in key or "_high" in key], 0.0
            )
        rows.append(row)
    times = np.linspace(0, 1, 11)
    return {
        "compactness": pd.DataFrame(compact),
        "generalisation": pd.DataFrame(general),
        "specificity": pd.DataFrame(specific),
        "comparison": pd.DataFrame(rows),
        "comparison_95": pd.DataFrame(rows).assign(modes=9),
        "labels_mean": pd.DataFrame(
            {
                "method": [method for method, *_ in COHORT_METHODS],
                "disagree_percent": [7 + level for _, level, *_ in COHORT_METHODS],
                "border_mm": [12 + level for _, level, *_ in COHORT_METHODS],
                "border_difference_mm": [level - 1.06 for _, level, *_ in COHORT_METHODS],
                "border_difference_low_mm": [level - 1.16 for _, level, *_ in COHORT_METHODS],
                "border_difference_high_mm": [level - 0.96 for _, level, *_ in COHORT_METHODS],
            }
        ),
        "interpolation": pd.DataFrame(
            [
                {
                    "case_id": case,
                    "t": t,
                    "conformal_distortion": 2 + 0.05 * t,
                    "straight_conformal_distortion": 2 + 0.05 * t + 0.09 * np.sin(np.pi * t),
                }
                for case in path_cases
                for t in times
            ]
        ),
    }


def _losses(steps: int, generator: np.random.Generator, collapsed: bool = False) -> pd.DataFrame:
    step = np.arange(1, steps + 1)
    noise = np.exp(generator.normal(0, 0.2, (4, steps)))
    fall = np.exp(-step / 80)
    terms = {
        "bijectivity": (180 * fall + 9) * noise[0],
        "orthogonality": (170 * fall + 12) * noise[1],
        "align": (2600 * fall + 160) * noise[2],
        "arap": np.where(step > steps // 3, (300 * fall + 20) * noise[3], np.nan),
    }
    rise = 1 - fall
    table = pd.DataFrame(
        {
            "step": step,
            "total": np.nansum(list(terms.values()), axis=0),
            **terms,
            "map_extent": 0.04 * noise[0] if collapsed else 0.05 + 0.93 * rise,
            "map_sharpness": 0.02 + (0 if collapsed else 0.4) * rise,
            "mean_cosine": np.full(steps, 0.97) if collapsed else 0.9 - 0.85 * rise,
            "share_hit": 0.03 + (0 if collapsed else 0.7) * rise,
        }
    )
    watched = list(table.columns[-4:])
    table.loc[(step % 25 > 0) & (step < steps), watched] = np.nan  # looked at now and then
    return table


def _check(ids: list[str], generator: np.random.Generator) -> tuple[pd.DataFrame, dict[str, bytes]]:
    table = pd.DataFrame(
        {
            "case_id": ids,
            "volume_ml": generator.normal(2000, 400, len(ids)),
            **{name: generator.standard_normal(len(ids)) for name in
               ("volume_z", "extent_z", "spectrum_z", "rigid_fit_z")},
            "components": 1,
            "remarks": "",
        }
    )  # fmt: skip
    table.loc[3, ["volume_z", "remarks"]] = [-7.4, "a thousandth of the others' volume: metres?"]
    table.loc[11, ["rigid_fit_z", "remarks"]] = [5.2, "fits better when mirrored"]
    table.loc[17, "spectrum_z"] = 4.1
    pictures = {}
    for case_id in ids:
        shade = 90 + zlib.crc32(case_id.encode()) % 120
        image = np.zeros((72, 72, 4), np.uint8)
        image[16:56, 20:52] = [shade, 150, 160, 255]
        buffer = io.BytesIO()
        Image.fromarray(image).save(buffer, "PNG")
        pictures[case_id] = buffer.getvalue()
    return table, pictures


def make_fits(content: ReportContent, seed: int = 11) -> tuple[FitReport, ...]:
    """Three made-up patients: an ordinary one, one upside down, one of whom the top was cut off."""
    model, generator = content.model, np.random.default_rng(seed)
    fits = []
    for number, (scale, turned, cut) in enumerate([(1.0, 4.0, 0), (1.6, 176.0, 0), (0.9, 6.0, 1)]):
        scores = scale * generator.standard_normal(model.mode_count)
        rotation = np.diag([1.0, -1.0, -1.0]) if turned > 90 else np.eye(3)
        vertices = model.reconstruct(scores) @ rotation.T + [30.0, -120.0, 900.0]
        surface = vertices + generator.normal(0, 0.6, vertices.shape)
        observed = vertices[:, 2] < np.quantile(vertices[:, 2], 0.7) if cut else vertices[:, 2] > 0
        faces = model.faces[observed[model.faces].all(axis=1)]
        sd = np.where(observed, 0.8, 4.0)
        flags = (
            ("turned: it lies 176 degrees from how the model's cases lie.",) if turned > 90 else ()
        )
        remarks = (
            ("a part of the surface is missing: 70% of the vertices were seen",) if cut else ()
        )
        fits.append(
            FitReport(
                case_id=f"1.2.826.0.1.3680043.8.498.{number}{'0123456789' * 4}",
                by="model",
                surface=Mesh(surface, faces, f"patient {number}"),
                faces=model.faces,
                vertices=vertices,
                observed=observed,
                distances_mm=np.abs(generator.normal(0, 0.7, len(vertices))),
                surface_distances_mm=np.abs(generator.normal(0, 0.7, len(vertices))),
                sd_mm=sd,
                radius_mm=1.28 * sd,
                frame=Similarity(1.0, rotation, np.array([30.0, -120.0, 900.0])),
                scores=scores,
                low=scores - 0.3,
                high=scores + 0.3,
                cohort_scores=model.scores,
                cohort_ids=model.case_ids,
                typicality=Typicality(
                    Judged(0.7, 0.41, 1.9), Judged(3.1 * scale, 0.2, 6.2), turned, 45.0, 1.3, flags
                ),
                noise_mm=0.6,
                remarks=remarks,
            )
        )
    return tuple(fits)


def make_comparison(content: ReportContent, seed: int = 2) -> ShapeComparison:
    """Two covariates; the effect of the first is known to be significant on the upper half only."""
    model, generator = content.model, np.random.default_rng(seed)
    count = len(model.case_ids)
    upper = model.mean[:, 2] > 0
    up = np.where(upper[:, None], [0.0, 0.0, 3.0], 0.0)
    covariates = pd.DataFrame(
        {
            "case_id": model.case_ids,
            "sex": np.where(np.arange(count) % 2, "f", "m"),
            "age": generator.uniform(30, 80, count).round(),
        }
    )
    columns = (
        Column(1, "sex", "sex: m against f", 1.0),
        Column(2, "age", "age: 14 more (1 SD)", 14.0),
    )
    matrix = np.column_stack([np.ones(count), covariates["sex"] == "m", covariates["age"]])
    rows = [{"effect": column.name, "mode": m} for column in columns for m in (1, 2, 3)]
    return ShapeComparison(
        design=Design("~ sex + age", matrix, columns, covariates),
        mode_count=3,
        tests=pd.DataFrame({"term": ["sex", "age"], "p": [0.002, 0.41]}),
        modes=pd.DataFrame(rows).assign(change_sd=0.4, p=0.02, q=0.04),
        power=pd.DataFrame({"effect": [c.name for c in columns], "detectable_sd": [1.1, 1.4]}),
        maps=(
            VertexMap(columns[0].name, up, np.where(upper, 0.001, 0.6), np.where(upper, 0.01, 0.7)),
            VertexMap(columns[1].name, 0.1 * up, np.full(len(up), 0.5), np.full(len(up), 0.9)),
        ),
    )

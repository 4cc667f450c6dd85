"""Speed and exactness of the evaluation: fast against naive, in one run.

    python benchmarks/bench_evaluation.py            22 shapes of 4000 points, 1000 draws
    python benchmarks/bench_evaluation.py --draws 20 quicker

The shapes are made here: a lung-sized ellipsoid with smooth random modes and 1 mm of noise.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from scipy.spatial import ConvexHull

from ssm_pipeline.evaluation.sampling import FixedPoints, spatial_order
from ssm_pipeline.evaluation.settings import EvaluationSettings
from ssm_pipeline.evaluation.specificity import nearest_chamfer, specificity
from ssm_pipeline.geometry.distances import PointTarget, chamfer
from ssm_pipeline.geometry.geodesics import geodesic_matrix
from ssm_pipeline.geometry.surface import face_normals, sample_points
from ssm_pipeline.records import CorrespondedShapes, Mesh
from ssm_pipeline.shape_model.alignment import align
from ssm_pipeline.shape_model.pca import pca_model


def even_sphere(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit sphere: `count` vertices on the golden spiral, outward faces."""
    index = np.arange(count) + 0.5
    polar, azimuth = np.arccos(1 - 2 * index / count), np.pi * (1 + 5**0.5) * index
    vertices = np.stack(
        [np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], axis=1
    )
    faces = ConvexHull(vertices).simplices.astype(np.int64)
    inward = np.einsum("fd,fd->f", face_normals(vertices, faces), vertices[faces[:, 0]]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return vertices, faces


def cohort(count: int, vertex_count: int, seed: int) -> tuple[CorrespondedShapes, list[Mesh]]:
    generator = np.random.default_rng(seed)
    sphere, faces = even_sphere(vertex_count)
    waves = generator.normal(size=(15, 3))
    modes = np.cos(sphere @ waves.T + generator.uniform(0, 6, 15)).T[:, :, None] * sphere
    scores = generator.standard_normal((count, 15)) * np.linspace(14, 2, 15)
    shapes = sphere * [60, 75, 120] + np.tensordot(scores, modes, axes=1)
    shapes += generator.normal(size=shapes.shape)
    ids = tuple(f"case_{index:02d}" for index in range(count))
    aligned, _ = align(CorrespondedShapes(shapes, faces, ids, ids[0]))
    return aligned, [Mesh(v, faces, i) for v, i in zip(aligned.vertices, ids, strict=True)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--naive-draws", type=int, default=10, help="draws per mode count, naive")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    shapes, meshes = cohort(22, 4000, arguments.seed)
    model = pca_model(shapes)
    settings = EvaluationSettings(samples=arguments.draws)

    start = time.perf_counter()
    table, _ = specificity(
        model, meshes, settings, np.random.default_rng(arguments.seed), arguments.jobs
    )
    fast = time.perf_counter() - start
    print(table.to_string(float_format="%.3f"))
    print(f"specificity, {len(table)} mode counts x {arguments.draws} draws: {fast:.1f} s")

    generator = np.random.default_rng(arguments.seed)
    points = FixedPoints.of(model.mean, model.faces, settings.points, generator)
    samples = [sample_points(m.vertices, m.faces, points.count, generator) for m in meshes]
    targets = [PointTarget.of(sample[spatial_order(sample)]) for sample in samples]
    fast_s, naive_s, misses, excess = 0.0, 0.0, 0, 0.0
    for modes in range(1, model.mode_count + 1):
        scores = generator.standard_normal((arguments.naive_draws, modes))
        draws = points.on(model.reconstruct(scores)).astype(np.float32)
        start = time.perf_counter()
        quick, _ = nearest_chamfer(
            draws, targets, settings.screening_points, settings.screening_errors
        )
        fast_s += time.perf_counter() - start
        start = time.perf_counter()
        naive = np.array(
            [min(chamfer(PointTarget.of(draw), target) for target in targets) for draw in draws]
        )
        naive_s += time.perf_counter() - start
        misses += int((quick > naive + 1e-9).sum())
        excess = max(excess, float((quick - naive).max()))
    checked = arguments.naive_draws * model.mode_count
    print(
        f"nearest Chamfer: {naive_s / fast_s:.1f} times the naive n x n version "
        f"({naive_s:.1f} s / {fast_s:.1f} s); nearest mesh missed in {misses} of {checked} draws, "
        f"largest excess {excess:.4f} mm"
    )

    sphere, faces = even_sphere(5000)
    start = time.perf_counter()
    matrix = geodesic_matrix(sphere, faces)
    seconds = time.perf_counter() - start
    truth = np.arccos(np.clip(sphere @ sphere.T, -1, 1))
    off = ~np.eye(len(sphere), dtype=bool)
    error = np.abs(matrix - truth)[off] / truth[off]
    print(
        f"geodesic matrix, 5000 vertices: {seconds:.1f} s; relative error to the great circle "
        f"mean {100 * error.mean():.2f} %, largest {100 * error.max():.2f} %"
    )


if __name__ == "__main__":
    main()

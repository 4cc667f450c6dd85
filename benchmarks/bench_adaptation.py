"""Adaptation of one pair: point-to-plane Gauss–Newton against VectorAdam, the same objective.

    python benchmarks/bench_adaptation.py [--vertices 4000] [--samples 40000] [--adam-steps 1000]

Two phantom lungs with known correspondences are put on each other by their centres and sizes, then
adapted by both solvers (both with k-d trees). Prints seconds, the objective reached and the ratio.
"""

from __future__ import annotations

import argparse
import time

import fast_simplification
import numpy as np

from ssm_pipeline.adaptation.gauss_newton import gauss_newton
from ssm_pipeline.adaptation.objective import AdaptationObjective, Triangles
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.adaptation.vector_adam import vector_adam
from ssm_pipeline.data_prep.synthetic.phantom_settings import PhantomSettings
from ssm_pipeline.data_prep.synthetic.smooth_phantoms import draw
from ssm_pipeline.records import Mesh, PhantomTruth
from ssm_pipeline.spectral.basis import spectral_basis
from ssm_pipeline.spectral.settings import SpectralSettings


def main() -> None:
    settings = AdaptationSettings()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vertices", type=int, default=4000)
    parser.add_argument("--samples", type=int, default=settings.samples)
    parser.add_argument("--adam-steps", type=int, default=1000)
    parser.add_argument("--learning-rate", type=float, default=1e-3)
    arguments = parser.parse_args()
    settings = AdaptationSettings(samples=arguments.samples)
    truth, _ = draw(PhantomSettings(cases=2))
    x, y = (
        spectral_basis(reduced(truth, case, arguments.vertices), SpectralSettings(eigenpairs=10))
        for case in (0, 1)
    )
    objective = AdaptationObjective(
        Triangles(x.vertices, x.faces),
        x.laplacian,
        Triangles(y.vertices, y.faces),
        settings,
        np.random.default_rng(0),
    )
    start = time.perf_counter()
    offsets, _ = gauss_newton(objective, settings.steps, settings.tangential)
    fast_seconds = time.perf_counter() - start
    fast = objective.value(offsets)
    print(f"{len(x.vertices)} vertices, {arguments.samples} samples")
    print(f"Gauss-Newton, {settings.steps} steps: {fast_seconds:.2f} s, objective {fast:.3e}")
    start = time.perf_counter()
    _, values = vector_adam(objective, arguments.adam_steps, arguments.learning_rate)
    adam_seconds = time.perf_counter() - start
    print(
        f"VectorAdam, {arguments.adam_steps} steps: {adam_seconds:.1f} s, "
        f"objective {values[-1]:.3e}"
    )
    print(f"ratio {adam_seconds / fast_seconds:.1f} in time, {values[-1] / fast:.3f} in objective")


def reduced(truth: PhantomTruth, case: int, vertices: int) -> Mesh:
    points, faces = fast_simplification.simplify(
        truth.vertices[case].astype(np.float32),
        truth.faces.astype(np.int32),
        target_count=2 * vertices - 4,
    )
    return Mesh(points, faces, truth.case_ids[case])


if __name__ == "__main__":
    main()

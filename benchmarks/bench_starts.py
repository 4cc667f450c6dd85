"""Where adaptation starts, on articulated figures with known truth: error and time per pair.

    python benchmarks/bench_starts.py "merged limbs" --steps 500 --cases 2 --templates 4

Prints the mean geodesic error × 100 (√area), its 90th percentile, the number of pairs
that end more than 20 % worse than the map of the features, and the seconds per pair. The network is
trained on figures of the development seed; the tested ones have a seed of their own.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd

from ssm_pipeline.adaptation.correspond import correspond_bases
from ssm_pipeline.adaptation.settings import AdaptationSettings
from ssm_pipeline.data_prep.synthetic.articulated import articulated_figure
from ssm_pipeline.data_prep.synthetic.articulated_merged import merged_figure, reference
from ssm_pipeline.data_prep.synthetic.articulated_settings import (
    DEVELOPMENT_SEED,
    REPORTED_SEED,
    ArticulatedSettings,
)
from ssm_pipeline.geometry.geodesics import geodesic_matrix
from ssm_pipeline.geometry.surface import area
from ssm_pipeline.matching.settings import MatchingSettings
from ssm_pipeline.meshing.decimation import decimate
from ssm_pipeline.records import Mesh
from ssm_pipeline.spectral.basis import spectral_basis
from ssm_pipeline.spectral.settings import SpectralSettings
from ssm_pipeline.training.matcher import Matcher, load_matcher
from ssm_pipeline.training.settings import TrainingSettings
from ssm_pipeline.training.train import train_networks

TRAINED = 20  # shapes; the tested ones follow
FACES = 2000  # triangles of the meshes trained on
SPECTRAL = SpectralSettings(eigenpairs=120)
ROWS = ("projected features", "network start", "full", "adaptation only")


def shape(figures: ArticulatedSettings, index: int) -> tuple[Mesh, np.ndarray]:
    """A mesh and its truth: per template point its vertex, or of merged figures the reverse."""
    if figures.family != "merged limbs":
        made = articulated_figure(figures, index)
        return made.mesh, made.template_to_shape
    if index == 0:
        mesh = reference(figures.vertices)
        return mesh, np.arange(len(mesh.vertices))
    merged = merged_figure(figures, index)
    return merged.mesh, merged.to_reference


def matcher_of(family: str, steps: int, path: Path | None) -> Matcher:
    if path is not None and path.exists():
        return load_matcher(path)
    figures = ArticulatedSettings(family=family, seed=DEVELOPMENT_SEED, training_shapes=TRAINED)
    meshes = [shape(figures, index)[0] for index in range(TRAINED)]
    settings = TrainingSettings(
        steps=steps,
        faces=FACES,
        matching=MatchingSettings(channels=256),
        time_steps=(1, 3),
        time_step_shares=(0.9, 0.1),
    )
    bases = [spectral_basis(decimate(mesh, FACES), SPECTRAL) for mesh in meshes]
    matcher = train_networks(bases, settings, seed=0)
    if path is not None:
        matcher.save(path)
    return matcher


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("family", choices=("near-isometric", "non-isometric", "merged limbs"))
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--matcher", type=Path, help="a matcher.pt, made if it is missing")
    parser.add_argument("--seed", type=int, default=REPORTED_SEED)
    parser.add_argument("--cases", type=int, default=2)
    parser.add_argument("--templates", type=int, default=3)
    parser.add_argument("--rows", nargs="+", default=list(ROWS))
    chosen = parser.parse_args()
    matcher = matcher_of(chosen.family, chosen.steps, chosen.matcher)
    figures = ArticulatedSettings(family=chosen.family, seed=chosen.seed, training_shapes=TRAINED)
    merged = chosen.family == "merged limbs"
    first = [0] if merged else list(range(TRAINED, TRAINED + chosen.cases))
    others = range(TRAINED + chosen.cases, TRAINED + chosen.cases + chosen.templates)
    rows, starts = [], Counter[str]()
    for x in first:
        case, on_case = shape(figures, x)
        distances = geodesic_matrix(case.vertices, case.faces, across_gaps=True)
        size = np.sqrt(area(case.vertices, case.faces))
        for y in others:
            template, truth = shape(figures, y)
            points, goal = (np.arange(len(truth)), truth) if merged else (truth, on_case)
            fine = spectral_basis(template, SPECTRAL), spectral_basis(case, SPECTRAL)
            coarse = (
                spectral_basis(decimate(template, FACES), SPECTRAL),
                spectral_basis(decimate(case, FACES), SPECTRAL),
            )
            for method in chosen.rows:
                began = time.process_time()
                match = correspond_bases(
                    fine[0], fine[1], matcher, AdaptationSettings(), method, coarse, 0
                )
                seconds = time.process_time() - began
                error = 100 * distances[match.nearest_vertex[points], goal].mean() / size
                rows.append({"pair": f"{y}→{x}", "method": method, "error": error, "s": seconds})
                starts[f"{method}: {match.start}"] += 1
                print(rows[-1], getattr(match, "start_reason", ""), flush=True)
    table = pd.DataFrame(rows)
    errors = table.pivot(index="pair", columns="method", values="error")[chosen.rows]
    print(errors.round(2).to_string())
    found = pd.DataFrame(
        {
            "mean": errors.mean(),
            "standard error": errors.std() / np.sqrt(len(errors)),
            "90th percentile": errors.quantile(0.9),
            "seconds": table.groupby("method")["s"].mean(),
        }
    ).loc[chosen.rows]
    if "projected features" in errors:
        worse = errors.gt(1.2 * errors["projected features"], axis=0)
        found["worse than the map"] = worse.sum()
    print(found.round(2).to_string())
    print(dict(starts))


if __name__ == "__main__":
    main()

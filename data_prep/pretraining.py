"""The shapes that the built-in weights are trained on: no patients, nobody's licence."""

from __future__ import annotations

import numpy as np

from data_prep.articulated import articulated_figure
from data_prep.articulated_settings import ArticulatedSettings
from data_prep.phantom_settings import PhantomSettings
from data_prep.phantoms import draw_truth
from data_prep.random_organs import random_family
from data_prep.remeshing import remeshed, renumbered
from ssm_pipeline.records import Mesh

# Neither of the seeds that choose settings nor of those that are reported.
SEED = 300
_RANDOM_FAMILIES, _RANDOM_CASES = 40, 3
_PHANTOMS = (("lung", 8), ("tube", 8), ("smooth", 6))
_FIGURES = (("near-isometric", 8), ("non-isometric", 8))
_VERTICES = (2500, 4000)  # of the triangulation that each organ gets of its own


def pretraining_shapes() -> tuple[list[Mesh], list[str]]:
    """158 surfaces, of some thousand vertices, and the family of each.

    Organ-like shapes of forty families, lung-like and tube-like phantoms, smooth lungs, and figures
    in many poses and of many builds; no two of one triangulation. A pair of shapes to train on is
    of one family.
    """
    generator = np.random.default_rng(SEED)
    drawn = [
        (f"organ-{number}", *random_family(generator, _RANDOM_CASES))
        for number in range(_RANDOM_FAMILIES)
    ]
    for name, cases in _PHANTOMS:
        truth = draw_truth(PhantomSettings(family=name, cases=cases, seed=SEED))
        drawn.append((name, list(truth.vertices), truth.faces))
    meshes: list[Mesh] = []
    families: list[str] = []
    for family, shapes, faces in drawn:
        for index, vertices in enumerate(shapes):
            mesh = renumbered(Mesh(vertices, faces, f"{family}.{index:03d}"), generator)
            meshes.append(remeshed(mesh, int(generator.integers(*_VERTICES))))
            families.append(family)
    for kind, cases in _FIGURES:
        settings = ArticulatedSettings(family=kind, seed=SEED, persons=8, training_shapes=cases)
        for index in range(cases):
            mesh = articulated_figure(settings, index).mesh
            meshes.append(Mesh(mesh.vertices, mesh.faces, f"{kind}.{index:03d}"))
        families += cases * [kind]
    return meshes, families

"""The shapes that the built-in weights are trained on: no patients, nobody's licence."""

from __future__ import annotations

from typing import Literal

import numpy as np

from ssm_pipeline.data_prep.synthetic.articulated import articulated_figure
from ssm_pipeline.data_prep.synthetic.articulated_settings import ArticulatedSettings
from ssm_pipeline.data_prep.synthetic.phantom_settings import PhantomSettings
from ssm_pipeline.data_prep.synthetic.phantoms import draw_truth
from ssm_pipeline.data_prep.synthetic.random_organs import random_family
from ssm_pipeline.data_prep.synthetic.remeshing import remeshed, renumbered
from ssm_pipeline.records import Mesh

# Neither of the seeds that choose settings nor of those that are reported.
SEED = 300
# How many cases of each. Weights that read coordinates start studies of organs; those that do not
# start figures, which the many organs of the first list crowd out.
_CASES = {
    "xyz+wks": {"lung": 8, "tube": 8, "smooth": 6, "near-isometric": 8, "non-isometric": 8},
    "wks": {"lung": 24, "tube": 24, "smooth": 16, "near-isometric": 16, "non-isometric": 16},
}
_RANDOM_FAMILIES = {"xyz+wks": 40, "wks": 0}
_RANDOM_CASES = 3
_PHANTOMS = ("lung", "tube", "smooth")
_FIGURES = ("near-isometric", "non-isometric")
_VERTICES = (2500, 4000)  # of the triangulation that each organ gets of its own


def pretraining_shapes(features: Literal["wks", "xyz+wks"]) -> tuple[list[Mesh], list[str]]:
    """158 surfaces for `xyz+wks`, 96 for `wks`, of some thousand vertices, and each one's family.

    Organ-like shapes of forty families (`xyz+wks` alone), lung-like and tube-like phantoms, smooth
    lungs, and figures in many poses and of many builds; no two of one triangulation. A pair of
    shapes to train on is of one family.
    """
    generator = np.random.default_rng(SEED)
    cases = _CASES[features]
    drawn = [
        (f"organ-{number}", *random_family(generator, _RANDOM_CASES))
        for number in range(_RANDOM_FAMILIES[features])
    ]
    for name in _PHANTOMS:
        truth = draw_truth(PhantomSettings(family=name, cases=cases[name], seed=SEED))
        drawn.append((name, list(truth.vertices), truth.faces))
    meshes: list[Mesh] = []
    families: list[str] = []
    for family, shapes, faces in drawn:
        for index, vertices in enumerate(shapes):
            mesh = renumbered(Mesh(vertices, faces, f"{family}.{index:03d}"), generator)
            meshes.append(remeshed(mesh, int(generator.integers(*_VERTICES))))
            families.append(family)
    for kind in _FIGURES:
        settings = ArticulatedSettings(
            family=kind, seed=SEED, persons=8, training_shapes=cases[kind]
        )
        for index in range(cases[kind]):
            mesh = articulated_figure(settings, index).mesh
            meshes.append(Mesh(mesh.vertices, mesh.faces, f"{kind}.{index:03d}"))
        families += cases[kind] * [kind]
    return meshes, families

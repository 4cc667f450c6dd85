"""The shapes that the built-in weights are trained on: no patients, nobody's licence."""

from __future__ import annotations

from data_prep.articulated import articulated_figure
from data_prep.articulated_settings import ArticulatedSettings
from data_prep.phantom_settings import PhantomSettings
from data_prep.phantoms import draw_truth
from ssm_pipeline.records import Mesh

# Neither of the seeds that choose settings nor of those that are reported.
SEED = 300
_PHANTOMS = (("lung", 24), ("tube", 24), ("smooth", 16))
_FIGURES = (("near-isometric", 16), ("non-isometric", 16))


def pretraining_shapes() -> tuple[list[Mesh], list[str]]:
    """96 surfaces, of one to ten thousand vertices, and the family of each.

    Lung-like and tube-like phantoms, smooth lungs, and figures in many poses and of many builds.
    A pair of shapes to train on is of one family.
    """
    meshes: list[Mesh] = []
    families: list[str] = []
    for family, cases in _PHANTOMS:
        truth = draw_truth(PhantomSettings(family=family, cases=cases, seed=SEED))
        meshes += [Mesh(v, truth.faces, f"{family}.{i:03d}") for i, v in enumerate(truth.vertices)]
        families += cases * [family]
    for kind, cases in _FIGURES:
        settings = ArticulatedSettings(family=kind, seed=SEED, persons=8, training_shapes=cases)
        for index in range(cases):
            mesh = articulated_figure(settings, index).mesh
            meshes.append(Mesh(mesh.vertices, mesh.faces, f"{kind}.{index:03d}"))
        families += cases * [kind]
    return meshes, families

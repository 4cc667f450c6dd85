"""Articulated figures with exact truth: people in many poses, each with its own triangulation.

They stand in for FAUST_r and SCAPE_r (near-isometric: few persons, many poses) and for SMAL_r and
DT4D-H (non-isometric: every figure has its own proportions), which may not be shipped.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from ssm_pipeline.data_prep.synthetic.articulated_body import BONES, rest_body
from ssm_pipeline.data_prep.synthetic.articulated_pose import draw_pose, draw_stance
from ssm_pipeline.data_prep.synthetic.articulated_settings import ArticulatedSettings
from ssm_pipeline.data_prep.synthetic.articulated_skin import Build, person, posed
from ssm_pipeline.data_prep.synthetic.remeshing import nearest_vertices, remeshed, renumbered
from ssm_pipeline.geometry.topology import directed_edges
from ssm_pipeline.records import Mesh, StudyError

CONTACT_MM = 22.0  # parts that come closer are in contact: about an edge of the remeshed surface
_APART_RINGS = 8  # edges of the reference body, 11 mm each, beyond which points are on other parts
_ATTEMPTS = 200
_ATTEMPTS_A_STANCE = 25  # not one, or stances that touch more easily would be rare
# Draws of one figure: each has a generator of its own, so that no set depends on another's size.
_BODY, _POSE = 0, 1


@dataclass(frozen=True, eq=False)
class Figure:
    """mesh: remeshed; template_to_shape (R,) int: its vertices nearest to the true points;
    points (R, 3) mm: where the template's points truly lie; surface (V, 3): the reference body's
    vertices, posed, on the faces of `rest_body`."""

    mesh: Mesh
    template_to_shape: np.ndarray
    points: np.ndarray
    surface: np.ndarray


def articulated_figure(settings: ArticulatedSettings, index: int) -> Figure:
    """One shape of the set: the same whatever others are made.

    Poses in which parts touch are drawn again, since there the nearest vertex may lie on another
    part.

    Raises:
        StudyError: If none of 200 poses is free of contact.
    """
    number, own_build = _person_of(settings, index)
    build = draw_build(_generator(settings, _BODY, number), own_build)
    at_rest = person(build)
    generator = _generator(settings, _POSE, index)
    for attempt in range(_ATTEMPTS):
        if attempt % _ATTEMPTS_A_STANCE == 0:
            stance = draw_stance(generator)
        surface = posed(at_rest, draw_pose(stance, generator))
        if not touches_itself(surface):
            break
    else:
        raise StudyError(
            f"figure {index}: in none of {_ATTEMPTS} poses its limbs keep {CONTACT_MM:g} mm apart. "
            f"Choose another seed than {settings.seed}."
        )
    case_id = f"figure{index:03d}-person{number:02d}"  # in order, by name as well
    count = round(settings.vertices * generator.uniform(0.9, 1.1))
    mesh = remeshed(renumbered(Mesh(surface, rest_body()[1], case_id), generator), count)
    points = surface[template_vertices(settings.template_vertices)]
    return Figure(mesh, nearest_vertices(mesh, points), points, surface)


def draw_build(generator: np.random.Generator, family: str) -> Build:
    """Proportions, the same left and right.

    Standard deviations: near-isometric 2.5 % of a length, 4 % of a girth, 3 % of girth common to
    the whole body; non-isometric 18, 17 and 12 %. Cut at twice as much.
    """
    length_sd, girth_sd, common_sd = (
        (0.025, 0.04, 0.03) if family == "near-isometric" else (0.18, 0.17, 0.12)
    )

    def draw(deviation: float) -> float:
        return float(np.exp(np.clip(generator.standard_normal(), -2, 2) * deviation))

    groups = list(dict.fromkeys(_group(bone.name) for bone in BONES))
    common = draw(common_sd)
    lengths = {group: draw(length_sd) for group in groups}
    girths = {group: common * draw(girth_sd) for group in groups}
    for group in ("head", "hand"):  # these keep their shape; hands and feet too thin would wear off
        lengths[group] = girths[group] = draw(girth_sd / 2)
    girths["foot"] = max(girths["foot"], 0.9)
    belly = 12 * generator.standard_normal() * (1 if family == "near-isometric" else 3)
    return Build(
        np.array([lengths[_group(bone.name)] for bone in BONES]),
        np.array([girths[_group(bone.name)] for bone in BONES]),
        float(np.clip(belly, -15, 70)),
    )


def touches_itself(surface: np.ndarray) -> bool:
    """True if parts of the body that are not neighbours come within CONTACT_MM, or cross."""
    pairs = cKDTree(surface).query_pairs(CONTACT_MM, output_type="ndarray")
    return not np.asarray(_neighbourhood()[pairs[:, 0], pairs[:, 1]]).all()


@functools.cache
def template_vertices(count: int) -> np.ndarray:
    """(R,) vertices of the reference body, about `count`, evenly spread over it."""
    vertices, faces = rest_body()
    body = Mesh(vertices, faces, "reference body")
    return np.unique(nearest_vertices(body, remeshed(body, count).vertices))


@functools.cache
def _neighbourhood() -> sp.csr_matrix:
    """(V, V) bool: which vertices of the reference body are within _APART_RINGS edges."""
    vertices, faces = rest_body()
    edges = directed_edges(faces)
    count = len(vertices)
    ring = sp.csr_matrix((np.ones(len(edges), bool), edges.T), shape=(count, count))
    ring = ring + sp.identity(count, dtype=bool, format="csr")
    reached = ring
    for _ in range(_APART_RINGS.bit_length() - 1):  # doubles the number of edges
        reached = reached @ reached
    return reached


def _person_of(settings: ArticulatedSettings, index: int) -> tuple[int, str]:
    """Which person figure `index` is, and of which family: person 0 and up.

    Near-isometric: the persons take turns in training; the first half of the test shapes are of
    persons seen there, the others of one that is not.
    """
    if settings.family == "non-isometric":
        return index, settings.family
    tested = index - settings.training_shapes
    unseen = tested >= settings.test_shapes // 2
    return settings.persons if unseen else index % settings.persons, settings.family


def _group(name: str) -> str:
    return name.removeprefix("left ").removeprefix("right ")


def _generator(settings: ArticulatedSettings, purpose: int, index: int) -> np.random.Generator:
    return np.random.default_rng([settings.seed, purpose, index])

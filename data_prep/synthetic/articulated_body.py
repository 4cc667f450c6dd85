"""A human body at rest: limbs as cones with round ends, blended into one closed surface.

Millimetres, LPS: +x the figure's left, +y its back, +z up; it stands with its arms and legs apart,
so that no limb is near another. Left and right are mirror images; front and back differ by nose,
chest, belly, buttocks, calves and feet.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import pymeshlab
from numpy.typing import ArrayLike

from ssm_pipeline.meshing.isosurface import isosurface
from ssm_pipeline.meshing.smooth_field import SmoothField

_BLEND_MM = 12.0  # edges between parts are rounded at about this radius
_CELL_MM = 9.0  # of the grid on which the surface is found
_EDGE_MM = 11.0  # of the reference mesh: about 17 000 vertices
_ARM = np.array([0.72, 0.0, -0.694])  # the left arm's direction at rest, 44° below level
_LEG = np.array([0.2, 0.0, -0.98])
_FORWARD = np.array([0.0, -1.0, 0.0])


@dataclass(frozen=True, eq=False)
class Bone:
    """joint (3,) where it turns against its parent; end (3,): with the joint, its direction."""

    name: str
    parent: int  # index into BONES, -1 for the root
    joint: np.ndarray
    end: np.ndarray


@dataclass(frozen=True, eq=False)
class Part:
    """A cone with round ends, of radius radii[0] at start and radii[1] at end.

    thin (3,) unit axis along which it's flattened to `thinness` of its width.
    """

    bone: str
    start: np.ndarray
    end: np.ndarray
    radii: tuple[float, float]
    thin: np.ndarray
    thinness: float = 1.0


def _bones() -> tuple[Bone, ...]:
    """Parents come before their children."""
    found: dict[str, tuple[str, np.ndarray, np.ndarray]] = {}

    def bone(name: str, parent: str, joint: ArrayLike, end: ArrayLike) -> None:
        found[name] = (parent, np.asarray(joint, float), np.asarray(end, float))

    bone("pelvis", "", [0, 0, 960], [0, 0, 1060])
    bone("waist", "pelvis", [0, 5, 1060], [0, 5, 1220])
    bone("chest", "waist", [0, 5, 1220], [0, 10, 1440])
    bone("neck", "chest", [0, 12, 1440], [0, 0, 1540])
    bone("head", "neck", [0, 0, 1545], [0, -5, 1750])
    for side, x in (("left", 1.0), ("right", -1.0)):
        mirror = np.array([x, 1.0, 1.0])
        shoulder = np.array([178, 10, 1405])
        elbow = shoulder + 285 * _ARM
        wrist = elbow + 250 * _ARM
        hip = np.array([92, 5, 930])
        knee = hip + 425 * _LEG
        ankle = knee + 410 * _LEG
        bone(f"{side} shoulder", "chest", mirror * [45, 10, 1410], mirror * shoulder)
        bone(f"{side} upper arm", f"{side} shoulder", mirror * shoulder, mirror * elbow)
        bone(f"{side} forearm", f"{side} upper arm", mirror * elbow, mirror * wrist)
        bone(f"{side} hand", f"{side} forearm", mirror * wrist, mirror * (wrist + 180 * _ARM))
        bone(f"{side} thigh", "pelvis", mirror * hip, mirror * knee)
        bone(f"{side} shin", f"{side} thigh", mirror * knee, mirror * ankle)
        bone(f"{side} foot", f"{side} shin", mirror * ankle, mirror * (ankle + 190 * _FORWARD))
    index = {name: number for number, name in enumerate(found)}
    return tuple(Bone(n, index.get(p, -1), joint, end) for n, (p, joint, end) in found.items())


BONES = _bones()
BONE_INDEX = {bone.name: number for number, bone in enumerate(BONES)}


def _parts() -> tuple[Part, ...]:
    found: list[Part] = []

    def part(
        bone: str,
        start: ArrayLike,
        end: ArrayLike,
        radii: tuple[float, float],
        thin: ArrayLike = (0, 1, 0),
        thinness: float = 1.0,
    ) -> None:
        axis = np.asarray(thin, float) / np.linalg.norm(np.asarray(thin))
        ends = np.asarray(start, float), np.asarray(end, float)
        found.append(Part(bone, *ends, radii, axis, thinness))

    part("pelvis", [-60, 5, 945], [60, 5, 945], (92, 92), thinness=0.95)
    part("waist", [0, 5, 1040], [0, 5, 1200], (136, 140), thinness=0.7)
    part("waist", [0, -38, 1075], [0, -30, 1130], (72, 65))  # belly
    part("chest", [-70, 10, 1290], [70, 10, 1290], (100, 100), thinness=0.95)
    part("chest", [-75, 15, 1370], [75, 15, 1370], (75, 75))
    part("neck", [0, 14, 1430], [0, 0, 1540], (56, 52))
    part("head", [0, 0, 1615], [0, 0, 1655], (90, 92), (1, 0, 0), 0.8)
    part("head", [0, -40, 1572], [0, -48, 1580], (46, 46), (1, 0, 0), 0.85)  # jaw
    part("head", [0, -86, 1640], [0, -100, 1612], (13, 17))  # nose
    for side, x in (("left", 1.0), ("right", -1.0)):
        mirror = np.array([x, 1.0, 1.0])

        def limb(
            bone: str,
            start: float,
            end: float,
            radii: tuple[float, float],
            forward: float = 0,
            side: str = side,
            mirror: np.ndarray = mirror,
        ) -> None:
            """From and to these shares of the bone, moved forward by millimetres."""
            at = BONES[BONE_INDEX[f"{side} {bone}"]]
            along = at.end - at.joint
            shift = forward * _FORWARD
            part(at.name, at.joint + start * along + shift, at.joint + end * along + shift, radii)

        part("pelvis", mirror * [65, 55, 905], mirror * [65, 50, 925], (72, 66))  # buttocks
        part("chest", mirror * [68, -46, 1300], mirror * [85, -42, 1345], (50, 46))  # chest muscle
        limb("shoulder", 0.15, 0.95, (56, 56))
        limb("upper arm", 0, 1, (52, 38))
        limb("forearm", 0, 1, (38, 25))
        limb("forearm", 0.1, 0.5, (36, 30), 4)
        limb("thigh", 0, 1, (80, 52))
        limb("thigh", 0.1, 0.6, (70, 56), 10)
        limb("shin", 0, 1, (52, 33))
        limb("shin", 0.15, 0.5, (44, 34), -22)  # calf
        hand = BONES[BONE_INDEX[f"{side} hand"]]
        palm = np.cross(_ARM * mirror, _FORWARD)  # at rest the thumb points forward
        across = hand.end - hand.joint
        fingers = hand.joint + 0.25 * across, hand.joint + 0.75 * across
        part(hand.name, *fingers, (45, 40), palm, 0.48)
        thumb = fingers[0] + 25 * _FORWARD, hand.joint + 0.55 * across + 78 * _FORWARD
        part(hand.name, *thumb, (22, 19))
        ankle = BONES[BONE_INDEX[f"{side} foot"]].joint
        heel = np.add(ankle, [0, 20, -46]), np.add(ankle, [0, 0, -40])
        part(f"{side} foot", *heel, (31, 33))
        sole = np.add(ankle, [0, 0, -45]), ankle + mirror * [12, -150, -54]
        part(f"{side} foot", *sole, (38, 40), (0, 0, 1), 0.7)
    return tuple(found)


PARTS = _parts()


@functools.cache
def rest_body() -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) mm and faces (F, 3) of the reference body, about 17 000 vertices."""
    points = np.concatenate([[part.start, part.end] for part in PARTS])
    low, high = points.min(axis=0) - 150, points.max(axis=0) + 150
    axes = [np.arange(a, b, _CELL_MM) for a, b in zip(low, high, strict=True)]
    inside = np.ascontiguousarray(-_grid_values(axes).T)
    surface = isosurface(SmoothField(inside, _CELL_MM, low, np.eye(3), level=0.0), "reference body")
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(surface.vertices, surface.faces))
    meshes.meshing_isotropic_explicit_remeshing(
        targetlen=pymeshlab.PureValue(_EDGE_MM), iterations=8, featuredeg=180, checksurfdist=False
    )
    result = meshes.current_mesh()
    return result.vertex_matrix(), result.face_matrix().astype(np.int64)


def _grid_values(axes: list[np.ndarray]) -> np.ndarray:
    """(X, Y, Z) about the distance outside the body, mm; negative inside.

    The soft minimum of the parts, −r log Σ exp(−d_i / r), of which a part adds nothing that counts
    eight radii r away.
    """
    total = np.full([len(axis) for axis in axes], 1e-6)
    for part in PARTS:
        ends, reach = np.stack([part.start, part.end]), max(part.radii) + 8 * _BLEND_MM
        box = tuple(
            slice(*np.searchsorted(axis, [near.min() - reach, near.max() + reach]))
            for axis, near in zip(axes, ends.T, strict=True)
        )
        local = [axis[along] for axis, along in zip(axes, box, strict=True)]
        grid = np.stack(np.meshgrid(*local, indexing="ij"), axis=-1)
        distance = part_distance(part, grid.reshape(-1, 3)).reshape(grid.shape[:3])
        total[box] += np.exp(-distance / _BLEND_MM)
    result: np.ndarray = -_BLEND_MM * np.log(total)
    return result


def part_distance(part: Part, points: np.ndarray) -> np.ndarray:
    """(P, 3) mm → (P,) distance outside one part, mm, short of exact where it is flattened."""

    def stretched(vectors: np.ndarray) -> np.ndarray:
        along = (vectors @ part.thin)[..., None] * part.thin
        return np.asarray(vectors + (1 / part.thinness - 1) * along)

    offset, axis = stretched(points - part.start), stretched(part.end - part.start)
    share = np.clip(offset @ axis / (axis @ axis), 0, 1)
    radius = part.radii[0] + share * (part.radii[1] - part.radii[0])
    distance = np.linalg.norm(offset - share[:, None] * axis, axis=1) - radius
    return np.asarray(distance * part.thinness)

"""How the body's surface follows its bones: smooth weights, other proportions, poses."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import robust_laplacian
import scipy.sparse as sp
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from ssm_pipeline.data_prep.synthetic.articulated_body import (
    BONE_INDEX,
    BONES,
    PARTS,
    Bone,
    part_distance,
    rest_body,
)

_SPREAD = 0.6  # of the limb's radius: how far a weight reaches over a joint


@dataclass(frozen=True, eq=False)
class Build:
    """A person: lengths and girths (B,), one factor a bone, and the belly, mm forward."""

    lengths: np.ndarray
    girths: np.ndarray
    belly_mm: float = 0.0


@dataclass(frozen=True, eq=False)
class Person:
    """vertices (V, 3) mm at rest; joints (B, 3) mm."""

    vertices: np.ndarray
    joints: np.ndarray


@functools.cache
def skin_weights() -> np.ndarray:
    """(V, B) non-negative, rows sum to 1: each vertex's bone, diffused along the surface.

    Two implicit steps of the heat equation, with a diffusivity in proportion to the limb's
    radius squared: at a joint of radius r the change from one bone to the next takes about r.
    """
    vertices, faces = rest_body()
    distances = np.stack([part_distance(part, vertices) for part in PARTS])
    nearest = distances.argmin(axis=0)
    bones = np.array([BONE_INDEX[part.bone] for part in PARTS])[nearest]
    radii = np.array([np.mean(part.radii) * np.sqrt(part.thinness) for part in PARTS])[nearest]
    laplacian, mass = robust_laplacian.mesh_laplacian(vertices, faces)
    edges = sp.triu(laplacian, 1).tocoo()
    # Off the diagonal of an intrinsic Delaunay Laplacian nothing is positive, so that no weight
    # can leave [0, 1].
    speeds = (_SPREAD * (radii[edges.row] + radii[edges.col]) / 2) ** 2
    links = sp.coo_matrix((speeds * np.minimum(edges.data, 0), (edges.row, edges.col)), mass.shape)
    links = (links + links.T).tocsr()
    slowed = links - sp.diags(np.asarray(links.sum(axis=1)).ravel())
    heat = splu((mass + slowed).tocsc())
    weights = np.eye(len(BONES))[bones]
    for _ in range(2):
        weights = heat.solve(mass @ weights)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def person(build: Build) -> Person:
    """The reference body with other proportions: vertex v is the same point of every person.

    Each bone scales what follows it along its direction and across; weights blend the bones'
    affine maps.
    """
    vertices, _ = rest_body()
    weights = skin_weights()
    maps = [
        girth * np.eye(3) + (length - girth) * np.outer(axis, axis)
        for length, girth, axis in zip(build.lengths, build.girths, map(_axis, BONES), strict=True)
    ]
    joints = np.zeros((len(BONES), 3))
    grown = np.zeros_like(vertices)
    for number, bone in enumerate(BONES):
        if bone.parent < 0:
            joints[number] = bone.joint
        else:
            offset = bone.joint - BONES[bone.parent].joint
            joints[number] = joints[bone.parent] + maps[bone.parent] @ offset
        moved = (vertices - bone.joint) @ maps[number].T + joints[number]
        grown += weights[:, number : number + 1] * moved
    from_navel = (vertices - [0, -110, 1095]) / [110, 90, 100]
    grown[:, 1] -= build.belly_mm * np.exp(-0.5 * (from_navel**2).sum(axis=1))
    return Person(grown, joints)


def posed(at_rest: Person, rotations: Rotation) -> np.ndarray:
    """(V, 3) mm: the person with each bone turned about its joint by its rotation (B).

    The axes are the body's at rest, turned with the parent bone. Dual quaternion skinning, which
    keeps the volume of bent and twisted limbs. Source: Kavan et al. 2008.
    """
    turns: list[Rotation] = []
    shifts = np.zeros((len(BONES), 3))  # x → turn · x + shift
    for number, bone in enumerate(BONES):
        joint, own = at_rest.joints[number], rotations[number]
        if bone.parent < 0:
            turns.append(own)
            shifts[number] = joint - own.apply(joint)
        else:
            turns.append(turns[bone.parent] * own)
            here = turns[bone.parent].apply(joint) + shifts[bone.parent]
            shifts[number] = here - turns[number].apply(joint)
    real = np.stack([turn.as_quat(scalar_first=True) for turn in turns])
    for number, bone in enumerate(BONES):  # the shorter way round, from each parent
        if bone.parent >= 0 and real[number] @ real[bone.parent] < 0:
            real[number] *= -1
    pure = np.concatenate([np.zeros((len(BONES), 1)), shifts], axis=1)
    dual = 0.5 * _product(pure, real)
    weights = skin_weights()
    real, dual = weights @ real, weights @ dual
    length = np.linalg.norm(real, axis=1, keepdims=True)
    real, dual = real / length, dual / length
    conjugate = real * [1, -1, -1, -1]
    moved = Rotation.from_quat(real, scalar_first=True).apply(at_rest.vertices)
    return np.asarray(moved + 2 * _product(dual, conjugate)[:, 1:])


def _axis(bone: Bone) -> np.ndarray:
    along = bone.end - bone.joint
    return np.asarray(along / np.linalg.norm(along))


def _product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Hamilton's product of quaternions (…, 4), the real part first."""
    real = p[..., :1] * q[..., :1] - (p[..., 1:] * q[..., 1:]).sum(axis=-1, keepdims=True)
    vector = p[..., :1] * q[..., 1:] + q[..., :1] * p[..., 1:] + np.cross(p[..., 1:], q[..., 1:])
    return np.concatenate([real, vector], axis=-1)

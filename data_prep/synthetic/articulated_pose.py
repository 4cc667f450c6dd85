"""Poses of a human figure, drawn from generous ranges of each joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ssm_pipeline.data_prep.synthetic.articulated_body import BONE_INDEX, BONES

_FORWARD, _BACK = np.array([0.0, -1.0, 0.0]), np.array([0.0, 1.0, 0.0])

Range = tuple[float, float]  # degrees


@dataclass(frozen=True)
class LegRanges:
    """Degrees: the thigh forward, to the side and about itself; knee; ankle."""

    forward: Range
    outward: Range
    twist: Range
    knee: Range
    ankle: Range = (-20, 30)


@dataclass(frozen=True)
class Stance:
    """One leg's ranges and the other's; which leg is which is drawn."""

    one: LegRanges
    other: LegRanges


def _both(legs: LegRanges) -> Stance:
    return Stance(legs, legs)


STANCES = (
    _both(LegRanges((-5, 15), (2, 30), (-20, 20), (0, 15))),  # standing
    Stance(  # a step
        LegRanges((20, 65), (2, 20), (-15, 15), (5, 60)),
        LegRanges((-30, -5), (2, 15), (-15, 15), (5, 45)),
    ),
    _both(LegRanges((60, 92), (12, 40), (-15, 15), (55, 95))),  # crouching
    Stance(  # a knee or a foot lifted
        LegRanges((65, 95), (5, 30), (-20, 20), (0, 95)),
        LegRanges((-5, 15), (2, 15), (-15, 15), (0, 20)),
    ),
    _both(LegRanges((50, 85), (2, 20), (-10, 10), (0, 15))),  # bent forward
)
STANCE_CHANCES = (0.25, 0.25, 0.25, 0.15, 0.10)
# Of one arm: elevation above level, angle forward of the side.
ARMS: tuple[tuple[Range, Range], ...] = (
    ((35, 82), (-5, 60)),  # over the head
    ((-15, 35), (-20, 95)),  # level
    ((-68, -15), (-25, 80)),  # below
)
ARM_CHANCES = (0.3, 0.25, 0.45)
# Of an arm whose hand may lie on the body, and of legs that may touch, for figures that merge.
ARM_ON_BODY: tuple[Range, Range] = ((-88, -60), (-10, 90))
_LEGS_TOGETHER = _both(LegRanges((-5, 15), (-16, -6), (-10, 10), (0, 15)))
ELBOW: Range = (0, 105)
ARM_TWIST: Range = (-60, 60)
WRIST: Range = (-35, 35)
SPINE: tuple[Range, Range, Range] = ((-12, 35), (-20, 20), (-35, 35))  # forward, side, twist
HEAD: tuple[Range, Range, Range] = ((-25, 30), (-18, 18), (-50, 50))


def draw_stance(generator: np.random.Generator) -> Stance:
    """Standing, stepping, crouching, with a leg lifted or bent forward."""
    return STANCES[generator.choice(len(STANCES), p=STANCE_CHANCES)]


def draw_pose(stance: Stance, generator: np.random.Generator) -> Rotation:
    """One rotation a bone, each in the body's axes at rest, turned with its parent."""
    rotations = {bone.name: Rotation.identity() for bone in BONES}
    spine, head = (
        np.radians([generator.uniform(*angle) for angle in ranges]) for ranges in (SPINE, HEAD)
    )
    for names, vector in ((("waist", "chest"), spine), (("neck", "head"), head)):
        for name in names:  # two bones share the turn
            rotations[name] = Rotation.from_rotvec(vector / 2)
    sides = ["left", "right"]
    generator.shuffle(sides)
    for side, ranges in zip(sides, (stance.one, stance.other), strict=True):
        rotations |= _leg(generator, side, ranges)
    for side in sides:
        rotations |= _arm(generator, side, *ARMS[generator.choice(len(ARMS), p=ARM_CHANCES)])
    rotations["pelvis"] = _upright(rotations)
    return Rotation.concatenate([rotations[bone.name] for bone in BONES])


def draw_touching_pose(generator: np.random.Generator) -> Rotation:
    """A pose in which a hand often lies on the body, or the legs are together."""
    together = generator.uniform() < 0.3
    stance = _LEGS_TOGETHER if together else draw_stance(generator)
    rotations = draw_pose(stance, generator)
    for side in ("left", "right"):
        if generator.uniform() < 0.6:
            for name, turn in _arm(generator, side, *ARM_ON_BODY).items():
                rotations[BONE_INDEX[name]] = turn
    return rotations


def _arm(
    generator: np.random.Generator, side: str, up: Range, forward: Range
) -> dict[str, Rotation]:
    elevation, azimuth = np.radians(generator.uniform(*up)), np.radians(generator.uniform(*forward))
    aim = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            -np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    along = _direction("left upper arm")
    to_aim = _least_turn(along, aim)
    blade = 0.25 * to_aim  # the shoulder blade takes part in what the arm does
    hinge = np.cross(along, _FORWARD)
    twist, elbow, wrist = (generator.uniform(*span) for span in (ARM_TWIST, ELBOW, WRIST))
    upper = Rotation.from_rotvec(blade).inv() * Rotation.from_rotvec(to_aim)
    turned = {
        "shoulder": Rotation.from_rotvec(blade),
        "upper arm": upper * Rotation.from_rotvec(np.radians(twist) * along * 0.6),
        # Some of the twist lies in the forearm, as when a hand is turned over.
        "forearm": Rotation.from_rotvec(np.radians(elbow) * hinge)
        * Rotation.from_rotvec(np.radians(twist) * along * 0.2),
        "hand": Rotation.from_rotvec(np.radians(wrist) * _BACK)
        * Rotation.from_rotvec(np.radians(twist) * along * 0.2),
    }
    return _on_side(side, turned)


def _leg(generator: np.random.Generator, side: str, ranges: LegRanges) -> dict[str, Rotation]:
    forward, outward, twist, knee, ankle = (
        np.radians(generator.uniform(*span))
        for span in (ranges.forward, ranges.outward, ranges.twist, ranges.knee, ranges.ankle)
    )
    aim = np.array([np.sin(outward), 0, -np.cos(outward)])
    aim = Rotation.from_rotvec([-forward, 0, 0]).apply(aim)
    along = _direction("left thigh")
    hinge = np.cross(along, _BACK)
    turned = {
        "thigh": Rotation.from_rotvec(_least_turn(along, aim))
        * Rotation.from_rotvec(twist * along),
        "shin": Rotation.from_rotvec(knee * hinge / np.linalg.norm(hinge)),
        "foot": Rotation.from_rotvec([ankle, 0, 0]),
    }
    return _on_side(side, turned)


def _on_side(side: str, turned: dict[str, Rotation]) -> dict[str, Rotation]:
    """The left limb's rotations, or their mirror images for the right."""
    mirror = np.array([1.0, 1, 1]) if side == "left" else np.array([1.0, -1, -1])
    return {
        f"{side} {name}": Rotation.from_rotvec(turn.as_rotvec() * mirror)
        for name, turn in turned.items()
    }


def _upright(rotations: dict[str, Rotation]) -> Rotation:
    """The turn of the pelvis, to front or back, that puts it above the feet."""
    ankles = []
    for side in ("left", "right"):
        thigh, shin = rotations[f"{side} thigh"], rotations[f"{side} shin"]
        hip, knee, ankle = (
            BONES[BONE_INDEX[f"{side} {name}"]].joint for name in ("thigh", "shin", "foot")
        )
        ankles.append(hip + thigh.apply(knee - hip + shin.apply(ankle - knee)))
    below = np.mean(ankles, axis=0) - BONES[BONE_INDEX["pelvis"]].joint
    return Rotation.from_rotvec([-np.arctan2(below[1], -below[2]), 0, 0])


def _direction(name: str) -> np.ndarray:
    bone = BONES[BONE_INDEX[name]]
    result: np.ndarray = (bone.end - bone.joint) / np.linalg.norm(bone.end - bone.joint)
    return result


def _least_turn(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(3,) rotation vector that takes one unit vector to the other the shortest way."""
    axis = np.cross(start, end)
    sine = np.linalg.norm(axis)
    if sine < 1e-9:
        return np.zeros(3)
    return np.asarray(axis / sine * np.arctan2(sine, start @ end))

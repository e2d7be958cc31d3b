"""Bones and girths of the generic hand, from published anthropometry, laid out flat in the hand frame (right hand).

Sources:

- Bone lengths and the soft tissue beyond the last bone: A. Buryanov, V. Kotiuk, "Proportions of Hand Segments",
  International Journal of Morphology 28(3):755-758, 2010, Table I (radiographs of 66 adults of both sexes).
- Breadths and circumferences of finger joints and wrist: T. M. Greiner, "Hand Anthropometry of U.S. Army Personnel",
  Natick TR-92/011, 1991 (means of 1003 men), brought by ``MALE_TO_MEAN_SIZE`` to the hand of both sexes.
- Hand length and breadth of both sexes: ANSUR II, "2012 Anthropometric Survey of U.S. Army Personnel" (Gordon et al.,
  Natick TR-15/007, 2014): 189.3 mm and 85.0 mm; Greiner's men: 194.5 mm from the wrist to the middle fingertip.

Where the bones stand (carpus, fan of the metacarpals, arch of the palm, turn of the thumb) is in no such table: those
numbers are ours, chosen so that hand length, hand breadth and the reach of the thumb come out as published.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import FINGERS
from getagrip.geometry import se3
from getagrip.hands.model import KNUCKLES, MANO_JOINTS

MANO_WRIST_M = np.array([0.0957, 0.0064, 0.0062])
"""The wrist joint; where MANO has it, so that poses of either hand put the wrist at the same place."""
MALE_TO_MEAN_SIZE = 189.3 / 194.5
"""Size of the mean hand of both sexes over that of Greiner's men."""

BONE_LENGTHS_MM = {
    "thumb": (46.22, 31.57, 21.67, 5.67),
    "index": (68.12, 39.78, 22.38, 15.82, 3.84),
    "middle": (64.60, 44.63, 26.33, 17.40, 3.95),
    "ring": (58.00, 41.37, 25.65, 17.30, 3.95),
    "pinky": (53.69, 32.74, 18.11, 15.96, 3.73),
}
"""Metacarpal, phalanges, soft tissue at the tip [mm]."""
JOINT_GIRTHS_MM = {
    "thumb": ((24.0, 72.3),),
    "index": ((23.0, 68.4), (20.3, 57.4)),
    "middle": ((22.5, 69.6), (19.8, 57.8)),
    "ring": ((21.4, 64.9), (18.5, 53.8)),
    "pinky": ((19.2, 57.8), (17.4, 49.2)),
}
"""Breadth and circumference [mm] at the joints between the phalanges."""

METACARPAL_BASES_MM = {"index": (27.0, 9.5), "middle": (31.0, 0.5), "ring": (31.0, -8.0), "pinky": (28.0, -15.5)}
"""Bases of the metacarpals: beyond the wrist, and towards the thumb [mm]."""
KNUCKLE_OFFSETS_MM = {"index": (-2.0, 24.0), "middle": (0.0, 1.5), "ring": (-1.5, -19.5), "pinky": (-5.0, -38.5)}
"""Knuckles: towards the back of the hand, and towards the thumb [mm]."""
FINGER_FAN_DEG = {"index": 7.0, "middle": 0.5, "ring": -6.5, "pinky": -15.0}
"""Directions of the fingers, towards the thumb [degrees]."""
FINGER_CURL_DEG = (3.0, 6.0, 5.0)
"""How much each joint of a resting flat finger bends [degrees]."""
THUMB_BASE_MM = np.array([-20.0, -13.0, 19.0])
"""Saddle joint of the thumb, from the wrist, in the hand frame [mm]."""
THUMB_DIRECTION = np.array([-0.70, -0.26, 0.66])
"""Direction of the thumb's metacarpal at rest."""
THUMB_PAD_DIRECTION = np.array([-0.55, -0.60, -0.58])
"""Direction of the thumb's pad at rest."""
THUMB_CURL_DEG = (0.0, 9.0, 5.0)
"""How much each joint of the resting thumb bends [degrees]."""


@dataclass(frozen=True)
class Finger:
    """A finger at rest: a chain of four points from the first joint to the tip of the last bone's soft tissue."""

    points: Float[ndarray, "4 3"]
    """First, second, third joint and the tip of the flesh [m]."""
    axes: Float[ndarray, "3 3 3"]
    """For each of the three segments the directions (along, across, towards the back), as rows."""
    breadth: Float[ndarray, "4"]
    """Half breadths at the four points [m]."""
    depth: Float[ndarray, "4"]
    """Half depths, from pad to back, at the four points [m]."""


def half_depth(breadth: float, circumference: float) -> float:
    """Return half the other axis of an ellipse of given breadth and circumference, C ~ pi sqrt((b^2 + d^2) / 2)."""
    return 0.5 * float(np.sqrt(2.0 * (circumference / np.pi) ** 2 - breadth**2))


@cache
def rest_fingers() -> Mapping[str, Finger]:
    """Return the five fingers of the flat right hand [m]."""
    fingers = {finger: _thumb() if finger == "thumb" else _finger(finger) for finger in FINGERS}
    return MappingProxyType(fingers)


def rest_joints() -> Float[ndarray, "16 3"]:
    """Return the 16 joints of the flat right hand [m]."""
    joints = np.zeros((len(MANO_JOINTS), 3))
    joints[0] = MANO_WRIST_M
    for finger, knuckle in zip(rest_fingers().values(), KNUCKLES, strict=True):
        joints[knuckle : knuckle + 3] = finger.points[:3]
    return joints


def metacarpal_base(name: str) -> Float[ndarray, "3"]:
    """Return the base of a finger's metacarpal [m]; of the thumb's, its saddle joint."""
    if name == "thumb":
        return MANO_WRIST_M + THUMB_BASE_MM / 1e3
    beyond, across = METACARPAL_BASES_MM[name]
    return MANO_WRIST_M + np.array([-beyond, 0.0, across]) / 1e3


def _finger(name: str) -> Finger:
    base = metacarpal_base(name)
    up, across = (v / 1e3 for v in KNUCKLE_OFFSETS_MM[name])
    offset = np.array([up, MANO_WRIST_M[2] + across - base[2]])
    along = np.sqrt((BONE_LENGTHS_MM[name][0] / 1e3) ** 2 - offset @ offset)
    knuckle = base + np.array([-along, *offset])
    fan = np.radians(FINGER_FAN_DEG[name])
    aim = np.array([-np.cos(fan), 0.0, np.sin(fan)])
    girths = [(b, half_depth(b, c)) for b, c in JOINT_GIRTHS_MM[name]]
    root = (0.93 * girths[0][0], 1.06 * girths[0][1])  # the finger's root is narrower and deeper than its first joint
    tip = (0.80 * girths[1][0], 0.80 * girths[1][1])
    return _chain(
        knuckle, aim, np.array([0.0, -1.0, 0.0]), BONE_LENGTHS_MM[name][1:], FINGER_CURL_DEG, [root, *girths, tip]
    )


def _thumb() -> Finger:
    joint = JOINT_GIRTHS_MM["thumb"][0][0], half_depth(*JOINT_GIRTHS_MM["thumb"][0])
    base = (1.20 * joint[0], 1.45 * joint[1])  # the saddle joint lies deep in the ball of the thumb
    first = (1.02 * joint[0], 1.12 * joint[1])
    tip = (0.84 * joint[0], 0.78 * joint[1])
    return _chain(
        metacarpal_base("thumb"),
        THUMB_DIRECTION,
        THUMB_PAD_DIRECTION,
        BONE_LENGTHS_MM["thumb"],
        THUMB_CURL_DEG,
        [base, first, joint, tip],
    )


def _chain(
    start: Float[ndarray, "3"],
    aim: Float[ndarray, "3"],
    pad: Float[ndarray, "3"],
    bones: tuple[float, ...],
    curl: tuple[float, ...],
    girths: list[tuple[float, float]],
) -> Finger:
    aim = aim / np.linalg.norm(aim)
    hinge = np.cross(aim, pad)
    hinge /= np.linalg.norm(hinge)
    lengths = np.array([bones[0], bones[1], bones[2] + bones[3]]) / 1e3
    directions = [se3.exp_so3(np.radians(angle) * hinge) @ aim for angle in np.cumsum(curl)]
    points = start + np.cumsum([np.zeros(3), *(d * n for d, n in zip(directions, lengths, strict=True))], axis=0)
    axes = np.array([[d, hinge, np.cross(d, hinge)] for d in directions])
    axes[:, 2] *= -np.sign(axes[:, 2] @ pad)[:, None]
    size = MALE_TO_MEAN_SIZE * np.array(girths) / 1e3
    return Finger(points, axes, size[:, 0] / 2.0, size[:, 1])

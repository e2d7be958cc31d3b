"""The generic hand: free, watertight, with about as many vertices as MANO, and MANO's pose parameters.

It is built from published anthropometry and an implicit skin around the bones (``scripts/generic_surface.py``), and
from no other hand model. Shape parameters are relative: 0.1 enlarges a part by a tenth. Sources:

- Bone lengths and the soft tissue beyond the last bone: A. Buryanov, V. Kotiuk, "Proportions of Hand Segments",
  International Journal of Morphology 28(3):755-758, 2010, Table I (radiographs of 66 adults of both sexes).
- Breadths and circumferences of finger joints and wrist: T. M. Greiner, "Hand Anthropometry of U.S. Army Personnel",
  Natick TR-92/011, 1991 (means of 1003 men), scaled by ``MALE_TO_MEAN_SIZE`` to the mean hand of both sexes.
- Hand length and breadth of both sexes: ANSUR II, "2012 Anthropometric Survey of U.S. Army Personnel" (Gordon et al.,
  Natick TR-15/007, 2014): 189.3 mm and 85.0 mm; Greiner's men: 194.5 mm from the wrist to the middle fingertip.

No table has the arrangement of the bones (carpus, fan of the metacarpals, arch of the palm, turn of the thumb): its
numbers are ours, chosen such that hand length, hand breadth and the reach of the thumb come out as published.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.clip import FINGERS
from getagrip.geometry import se3
from getagrip.geometry.mesh import edge_table, vertex_normals
from getagrip.hands.model import KNUCKLES, MANO_JOINTS, PARENTS, HandModel, Side, mirrored_model
from getagrip.io.options import check_word

GENERIC_HAND_FILE = Path(__file__).with_name("generic_hand.npz")
"""File of the generic hand's vertices and faces."""
SHAPE_PARAMETER_NAMES = (
    "size", "thickness", "palm_length", "palm_breadth", "proximal_phalanges", "middle_phalanges", "distal_phalanges",
    "thumb_metacarpal", "thumb_proximal", "thumb_distal", "index_length", "ring_length", "pinky_length",
)  # fmt: skip
"""Names of the shape parameters: each enlarges one part."""
SHAPE_SIGMA = 0.1
"""Standard deviation of the shape parameters; those of single bones are 7 to 15 % (Buryanov, Kotiuk, Table I)."""
MANO_WRIST_M = np.array([0.0957, 0.0064, 0.0062])
"""The wrist joint [m], as in MANO, so that one pose puts the wrist of either model at the same position."""
MALE_TO_MEAN_SIZE = 189.3 / 194.5
"""Ratio of the mean hand of both sexes to that of Greiner's men."""

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
"""Positions of the metacarpals' bases: beyond the wrist, and towards the thumb [mm]."""
KNUCKLE_OFFSETS_MM = {"index": (-2.0, 24.0), "middle": (0.0, 1.5), "ring": (-1.5, -19.5), "pinky": (-5.0, -38.5)}
"""Positions of the knuckles: towards the back of the hand, and towards the thumb [mm]."""
FINGER_FAN_DEG = {"index": 7.0, "middle": 0.5, "ring": -6.5, "pinky": -15.0}
"""Directions of the fingers, towards the thumb [degrees]."""
FINGER_CURL_DEG = (3.0, 6.0, 5.0)
"""Bend of each joint of a flat finger at rest [degrees]."""
THUMB_BASE_MM = np.array([-20.0, -13.0, 19.0])
"""Saddle joint of the thumb, from the wrist, in the hand frame [mm]."""
THUMB_DIRECTION = np.array([-0.70, -0.26, 0.66])
"""Direction of the thumb's metacarpal at rest."""
THUMB_PAD_DIRECTION = np.array([-0.55, -0.60, -0.58])
"""Direction of the thumb's pad at rest."""
THUMB_CURL_DEG = (0.0, 9.0, 5.0)
"""Bend of each joint of the thumb at rest [degrees]."""


@lru_cache
def load(side: Side) -> HandModel:
    """Load the generic hand of a side; the left one is the right one mirrored in x.

    Raises ``UsageError`` for an unknown side.
    """
    check_word("side", side, Side)
    if side == "left":
        return mirrored_model(load("right"))
    with np.load(GENERIC_HAND_FILE, allow_pickle=False) as file:
        vertices, faces = file["vertices"].astype(float), file["faces"].astype(np.int64)
    fingers, joints = rest_fingers(), rest_joints()
    weights = skin_weights(vertices, faces, fingers)
    shape, joint_shape = stretch_directions(vertices, joints, weights, fingers)
    return HandModel(
        name="generic",
        side="right",
        template=vertices,
        faces=faces,
        joints=joints,
        weights=weights,
        tips=np.array([np.argmin(np.linalg.norm(vertices - f.points[3], axis=1)) for f in fingers.values()]),
        regions=generic_contact_regions(vertices, faces, fingers),
        shape_names=SHAPE_PARAMETER_NAMES,
        shape_directions=shape,
        joint_directions=joint_shape,
        shape_spread=np.full(len(SHAPE_PARAMETER_NAMES), SHAPE_SIGMA),
    )


def skin_weights(
    vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"], fingers: Mapping[str, Finger]
) -> Float[ndarray, "V 16"]:
    """Compute skinning weights: a vertex belongs to the nearest finger, and along it to the adjacent bones.

    Both memberships are smooth; vertices before the first joint of their finger belong to the wrist.
    """
    chains = [np.concatenate([metacarpal_base(name)[None], f.points]) for name, f in fingers.items()]
    chains[0] = chains[0][1:]  # the thumb's metacarpal is its first bone
    near = np.stack([_distance_to_chain(vertices, chain) for chain in chains], axis=1)
    member = (near / near.min(axis=1, keepdims=True)) ** -8.0
    member /= member.sum(axis=1, keepdims=True)
    weights = np.zeros((len(vertices), 16))
    for n, (name, finger) in enumerate(fingers.items()):
        before = metacarpal_base(name) if name != "thumb" else finger.points[0] - 0.02 * finger.axes[0, 0]
        points = np.concatenate([before[None], finger.points])
        rest = member[:, n]
        for k in range(3):
            along = _unit(points[k + 1] - points[k]) + _unit(points[k + 2] - points[k + 1])
            width = (0.9 if k else (1.5 if name == "thumb" else 1.1)) * finger.depth[k]
            beyond = _smooth_step((vertices - points[k + 1]) @ _unit(along) / width)
            if k:
                weights[:, KNUCKLES[n] + k - 1] = rest * (1.0 - beyond)
            rest = rest * beyond
        weights[:, KNUCKLES[n] + 2] = rest
    weights[:, 0] = 1.0 - weights[:, 1:].sum(axis=1)
    for _ in range(2):
        weights = 0.5 * weights + 0.5 * _neighbour_mean(weights, faces)
    weights[weights < 0.01] = 0.0
    return weights / weights.sum(axis=1, keepdims=True)


def stretch_directions(
    vertices: Float[ndarray, "V 3"],
    joints: Float[ndarray, "16 3"],
    weights: Float[ndarray, "V 16"],
    fingers: Mapping[str, Finger],
) -> tuple[Float[ndarray, "V 3 S"], Float[ndarray, "16 3 S"]]:
    """Compute the displacements of vertices and joints per unit of each shape parameter.

    A parameter stretches the space around each bone by a 3x3 matrix M_j: a point x of joint j moves by d_j + M_j (x -
    J_j), where d_j is the displacement of J_j by the parent's stretch; skinning weights blend these.
    """
    M = _bone_stretches(fingers)
    shift = np.zeros((len(SHAPE_PARAMETER_NAMES), 16, 3))
    for child, parent in enumerate(PARENTS):
        if parent >= 0:
            shift[:, child] = shift[:, parent] + M[:, parent] @ (joints[child] - joints[parent])
    shift[SHAPE_PARAMETER_NAMES.index("thickness")] = 0.0  # thicker flesh does not move the bones
    arm = vertices[:, None] - joints
    moved = shift[:, None] + np.einsum("sjab,vjb->svja", M, arm)
    return np.einsum("vj,svja->vas", weights, moved), np.moveaxis(shift, 0, -1)


def _bone_stretches(fingers: Mapping[str, Finger]) -> Float[ndarray, "S 16 3 3"]:
    M = {name: np.zeros((16, 3, 3)) for name in SHAPE_PARAMETER_NAMES}
    M["size"][:] = np.eye(3)
    M["palm_length"][0, 0, 0] = M["thickness"][0, 1, 1] = M["palm_breadth"][0, 2, 2] = 1.0
    for finger, knuckle in zip(fingers, KNUCKLES, strict=True):
        for k, phalanx in enumerate(("proximal", "middle", "distal")):
            a = fingers[finger].axes[k, 0]
            along = np.outer(a, a)
            M["thickness"][knuckle + k] = np.eye(3) - along
            if finger == "thumb":
                M[("thumb_metacarpal", "thumb_proximal", "thumb_distal")[k]][knuckle + k] = along
            else:
                M[f"{phalanx}_phalanges"][knuckle + k] = along
            if f"{finger}_length" in M:
                M[f"{finger}_length"][knuckle + k] = along
    return np.stack([M[name] for name in SHAPE_PARAMETER_NAMES])


def generic_contact_regions(
    vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"], fingers: Mapping[str, Finger]
) -> dict[str, Int[ndarray, "_"]]:
    """Return the pads of the fingertips, then the ball of the thumb, the fingers' roots and the edge of the palm."""
    normals = vertex_normals(vertices, faces)
    regions = {}
    for name, finger in fingers.items():
        local = (vertices - finger.points[2]) @ finger.axes[2].T
        near = _distance_to_chain(vertices, finger.points[2:]) < 1.3 * finger.breadth[2]
        regions[name] = np.flatnonzero(near & (local[:, 0] > 0.0) & (normals @ finger.axes[2, 2] < 0.1))
    x, _, z = vertices.T
    roots = np.stack([f.points[0] for name, f in fingers.items() if name != "thumb"])
    behind = x - np.interp(z, roots[::-1, 2], roots[::-1, 0])  # behind the line of the knuckles
    palmar = normals[:, 1] < -0.5
    thumb = fingers["thumb"]
    ball = _distance_to_chain(vertices, thumb.points[:2]) < 0.026
    taken = np.isin(np.arange(len(vertices)), np.concatenate(list(regions.values())))
    finger_side = z < thumb.points[1, 2] - 0.012
    regions["palm_fingers"] = np.flatnonzero(palmar & ~taken & (np.abs(behind - 0.004) < 0.016) & finger_side)
    regions["palm_thumb"] = np.flatnonzero((normals @ thumb.axes[0, 2] < -0.4) & ball & (behind > 0.02) & (z > 0.0))
    edge = (normals[:, 1] < 0.3) & (z < -0.022) & (behind > 0.02) & (x < 0.085)
    regions["palm_edge"] = np.flatnonzero(edge)
    order = (*FINGERS, "palm_thumb", "palm_fingers", "palm_edge")
    return {name: regions[name] for name in order}


def _distance_to_chain(X: Float[ndarray, "V 3"], chain: Float[ndarray, "n 3"]) -> Float[ndarray, "V"]:
    distances = []
    for a, b in pairwise(chain):
        t = np.clip((X - a) @ (b - a) / np.sum((b - a) ** 2), 0.0, 1.0)
        distances.append(np.linalg.norm(X - a - t[:, None] * (b - a), axis=1))
    return np.min(distances, axis=0)


def _neighbour_mean(values: Float[ndarray, "V n"], faces: Int[ndarray, "F 3"]) -> Float[ndarray, "V n"]:
    start, end = np.concatenate([(e := edge_table(faces)[:, :2]), e[:, ::-1]]).T
    total = np.zeros_like(values)
    np.add.at(total, start, values[end])
    return total / np.bincount(start, minlength=len(values))[:, None]


def _smooth_step(x: Float[ndarray, "V"]) -> Float[ndarray, "V"]:
    """Rise from 0 at -1 to 1 at 1, with zero slope at both."""
    t = np.clip((x + 1.0) / 2.0, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def _unit(v: Float[ndarray, "3"]) -> Float[ndarray, "3"]:
    return np.asarray(v / np.linalg.norm(v))


@dataclass(frozen=True)
class Finger:
    """A finger at rest: a chain of four points.

    Attributes:
        points: (4, 3) first, second and third joint, and the tip of the flesh [m].
        axes: (3, 3, 3) directions (along, across, towards the back) of each of the three segments, as rows.
        breadth: (4,) half breadths at the points [m].
        depth: (4,) half depths, from pad to back, at the points [m].
    """

    points: Float[ndarray, "4 3"]
    axes: Float[ndarray, "3 3 3"]
    breadth: Float[ndarray, "4"]
    depth: Float[ndarray, "4"]


def half_depth(breadth: float, circumference: float) -> float:
    """Compute half the depth of an ellipse of given breadth and circumference, C ~ pi sqrt((b^2 + d^2) / 2)."""
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
    """Return the base of a finger's metacarpal [m]; the thumb's is its saddle joint."""
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
    root = (0.93 * girths[0][0], 1.06 * girths[0][1])  # narrower and deeper than the first joint
    tip = (0.80 * girths[1][0], 0.80 * girths[1][1])
    pad = np.array([0.0, -1.0, 0.0])
    return _chain(knuckle, aim, pad, BONE_LENGTHS_MM[name][1:], FINGER_CURL_DEG, [root, *girths, tip])


def _thumb() -> Finger:
    joint = JOINT_GIRTHS_MM["thumb"][0][0], half_depth(*JOINT_GIRTHS_MM["thumb"][0])
    base = (1.20 * joint[0], 1.45 * joint[1])  # the saddle joint is deep in the ball of the thumb
    first = (1.02 * joint[0], 1.12 * joint[1])
    tip = (0.84 * joint[0], 0.78 * joint[1])
    start, bones, girths = metacarpal_base("thumb"), BONE_LENGTHS_MM["thumb"], [base, first, joint, tip]
    return _chain(start, THUMB_DIRECTION, THUMB_PAD_DIRECTION, bones, THUMB_CURL_DEG, girths)


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

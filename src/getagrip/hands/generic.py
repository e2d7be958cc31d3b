"""The generic hand: free, watertight, about MANO's size in vertices, driven by MANO's pose numbers.

It is built from published anthropometry (``generic_skeleton``) and an implicit skin around the bones
(``scripts/generic_surface.py``), and from no other hand model. Shape parameters are fractions: 0.1 makes a tenth more.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.clip import FINGERS
from getagrip.geometry.mesh import edge_table, vertex_normals
from getagrip.hands.generic_skeleton import Finger, metacarpal_base, rest_fingers, rest_joints
from getagrip.hands.model import KNUCKLES, PARENTS, HandModel, Side, mirrored_model
from getagrip.io.choices import check_word

GENERIC_HAND_FILE = Path(__file__).with_name("generic_hand.npz")
"""Its vertices and faces."""
SHAPE_PARAMETER_NAMES = (
    "size",
    "thickness",
    "palm_length",
    "palm_breadth",
    "proximal_phalanges",
    "middle_phalanges",
    "distal_phalanges",
    "thumb_metacarpal",
    "thumb_proximal",
    "thumb_distal",
    "index_length",
    "ring_length",
    "pinky_length",
)
"""Names of the shape parameters, each of which enlarges one part."""

SHAPE_SIGMA = 0.1
"""Standard deviation of the shape parameters; those of single bones are 7 to 15 % (Buryanov, Kotiuk, Table I)."""


@lru_cache
def load(side: Side) -> HandModel:
    """Load the generic hand of one side; the left one is the right one mirrored in x.

    Raises ``UsageError`` for no side.
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

    Both memberships are smooth; what lies before the first joint of its finger belongs to the wrist.
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

    A parameter stretches the space around each bone by a 3x3 matrix M_j: a point x that goes with joint j moves by
    d_j + M_j (x - J_j), where d_j is what the parent's stretch does to J_j; skinning weights blend these.
    """
    M = _bone_stretches(fingers)
    shift = np.zeros((len(SHAPE_PARAMETER_NAMES), 16, 3))
    for child, parent in enumerate(PARENTS):
        if parent >= 0:
            shift[:, child] = shift[:, parent] + M[:, parent] @ (joints[child] - joints[parent])
    shift[SHAPE_PARAMETER_NAMES.index("thickness")] = 0.0  # thicker flesh leaves the bones where they are
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
    """From 0 at -1 to 1 at 1, with zero slope there."""
    t = np.clip((x + 1.0) / 2.0, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def _unit(v: Float[ndarray, "3"]) -> Float[ndarray, "3"]:
    return np.asarray(v / np.linalg.norm(v))

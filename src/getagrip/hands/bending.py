"""Bend the fingers of any hand mesh with 21 joints, whatever its model.

Each vertex follows the nearest bone; over the mesh's edges the membership is smoothed, so that fingers that touch one
another stay apart. A bend turns what lies beyond a joint about the line through it.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import HandTrack
from getagrip.compiling import kernel
from getagrip.geometry import se3
from getagrip.geometry.mesh import edge_table

_WRIST_JOINT, _INDEX_KNUCKLE, _PINKY_KNUCKLE = 0, 5, 17
FINGER_CHAINS = np.arange(1, 21).reshape(5, 4)
"""Joints of each finger, from the palm to the tip."""
BONE_OF_JOINT = np.zeros((21, 5, 3))
"""Weight of each of the five fingers' three bones for each joint; for vertices: ``finger_weights``."""
for _k in range(3):
    BONE_OF_JOINT[FINGER_CHAINS[:, _k + 1], np.arange(5), _k] = 1.0
_N_WEIGHT_SMOOTHINGS = 4


def finger_weights(hand: HandTrack) -> Float[ndarray, "V 5 3"]:
    """Compute each vertex's weights of the fingers' three bones, from palm to tip; the rest is the palm's.

    The hand must have joints.
    """
    assert hand.joints is not None
    ends = [(a, b) for chain in FINGER_CHAINS for a, b in pairwise(chain)]
    ends += [(_WRIST_JOINT, knuckle) for knuckle in FINGER_CHAINS[:, 0]]
    some = np.unique(np.linspace(0, len(hand.vertices) - 1, 5).astype(int))
    a, b = (hand.joints[some][:, [pair[k] for pair in ends]] for k in (0, 1))
    nearest = np.argmin(_to_segments(hand.vertices[some], a, b).sum(axis=0), axis=1)
    weights = np.eye(len(ends))[nearest]
    first, second = edge_table(hand.faces)[:, :2].T
    count = np.bincount(np.concatenate([first, second]), minlength=len(weights)).astype(float)
    for _ in range(_N_WEIGHT_SMOOTHINGS):
        around = np.zeros_like(weights)
        np.add.at(around, first, weights[second])
        np.add.at(around, second, weights[first])
        weights = 0.5 * weights + 0.5 * around / np.maximum(count, 1.0)[:, None]
    return weights[:, :15].reshape(-1, 5, 3)


def bend_fingers(
    vertices: Float[ndarray, "T V 3"],
    joints: Float[ndarray, "T 21 3"],
    weights: Float[ndarray, "V 5 3"],
    angles: Float[ndarray, "T 5 3"],
    sideways: Float[ndarray, "T 5"] | None = None,
) -> tuple[Float[ndarray, "T V 3"], Float[ndarray, "T 21 3"]]:
    """Bend each finger's joints further by ``angles`` [rad], thumb first; return vertices and joints.

    Fingers bend about an axis across the palm, the thumb towards the knuckle of the index finger or away from it. Then
    each finger is turned ``sideways`` about its first joint [rad].
    """
    turns = se3.rotation_about_line(joints[:, FINGER_CHAINS[:, :3]], finger_hinge_axes(joints)[:, :, None], angles)
    if sideways is not None:
        first = joints[:, FINGER_CHAINS[:, 0]]
        turns[:, :, 0] = se3.rotation_about_line(first, finger_spread_axes(joints), sideways) @ turns[:, :, 0]
    for k in (1, 2):
        turns[:, :, k] = turns[:, :, k - 1] @ turns[:, :, k]
    moved, skeleton = np.empty_like(vertices), joints.copy()
    skeleton[:, FINGER_CHAINS[:, 1:]] = se3.transform(turns, joints[:, FINGER_CHAINS[:, 1:], None])[..., 0, :]
    _skin_vertices(vertices, np.ascontiguousarray(weights.reshape(-1, 15)), turns.reshape(-1, 15, 4, 4), moved)
    return moved, skeleton


@kernel("f3 f2 f4 f3", fastmath=False)
def _skin_vertices(vertices: ndarray, weights: ndarray, T: ndarray, moved: ndarray) -> None:
    """Move vertices (T, V, 3) by the motions (T, 15, 4, 4) of bones, weighted by the vertices' weights (V, 15)."""
    for v in range(vertices.shape[1]):
        for t in range(len(vertices)):
            for i in range(3):
                moved[t, v, i] = vertices[t, v, i]
        for bone in range(weights.shape[1]):
            w = weights[v, bone]
            if w == 0.0:  # most weights
                continue
            for t in range(len(vertices)):
                x, y, z = vertices[t, v, 0], vertices[t, v, 1], vertices[t, v, 2]
                for i in range(3):
                    to = T[t, bone, i, 0] * x + T[t, bone, i, 1] * y + T[t, bone, i, 2] * z + T[t, bone, i, 3]
                    moved[t, v, i] += w * (to - vertices[t, v, i])


def finger_hinge_axes(joints: Float[ndarray, "T 21 3"]) -> Float[ndarray, "T 5 3"]:
    """Compute the fingers' unit hinge axes: across the palm; the thumb's is normal to its plane with the index."""
    index, pinky = (joints[:, k] - joints[:, _WRIST_JOINT] for k in (_INDEX_KNUCKLE, _PINKY_KNUCKLE))
    palm = np.cross(index, pinky)
    thumb, ahead = (joints[:, k] - joints[:, FINGER_CHAINS[0, 0]] for k in (FINGER_CHAINS[0, 3], _INDEX_KNUCKLE))
    along = joints[:, FINGER_CHAINS[1:, 1]] - joints[:, FINGER_CHAINS[1:, 0]]
    fingers = np.cross(along, palm[:, None])
    axes = np.concatenate([np.cross(thumb, ahead)[:, None], fingers], axis=1)
    return np.asarray(axes / np.maximum(np.linalg.norm(axes, axis=-1, keepdims=True), 1e-12))


def finger_spread_axes(joints: Float[ndarray, "T 21 3"]) -> Float[ndarray, "T 5 3"]:
    """Compute the fingers' unit axes of sideways turns: perpendicular to hinges and first bones."""
    axes = np.cross(joints[:, FINGER_CHAINS[:, 1]] - joints[:, FINGER_CHAINS[:, 0]], finger_hinge_axes(joints))
    return np.asarray(axes / np.maximum(np.linalg.norm(axes, axis=-1, keepdims=True), 1e-12))


def _to_segments(
    X: Float[ndarray, "T V 3"], a: Float[ndarray, "T B 3"], b: Float[ndarray, "T B 3"]
) -> Float[ndarray, "T V B"]:
    """Compute distances of points to segments [m]."""
    d = b - a
    x = X[:, :, None] - a[:, None]
    t = np.clip(np.sum(x * d[:, None], axis=-1) / np.maximum(np.sum(d * d, axis=-1), 1e-12)[:, None], 0.0, 1.0)
    return np.asarray(np.linalg.norm(x - t[..., None] * d[:, None], axis=-1))

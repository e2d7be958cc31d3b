"""The flat hand behind a moving surface of MANO's joint tree, of which only the rotations of its bones are known.

A vertex that follows bone j is at x(t) = p(t) + B(t) l + A(t) y, with the place p and the rotation B of the parent's
joint, the rotation A of the bone, the offset l of its joint from the parent's, and the vertex's own offset y from the
joint. So l and y are linear least squares, from the wrist outwards. Along the axis of a joint that only bends they are
not told apart: a small ridge on y puts the joint in the middle of the vertices that follow it.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.hands.model import PARENTS

RIDGE = 1e-3
"""Of y, beside the mean square of its coefficients, which is 1."""
FOLLOWERS = 15
"""A joint is placed by so many vertices, those that the bone's rotation explains best beside its parent's."""
MOVES = 0.003
"""A vertex that does not follow the parent is at least so far from where it would be then, rms [m]."""
LEAST_TURN = np.radians(5.0)
"""Root mean square angle by which each bone must turn about its mean."""


def flat_hand(
    x: Float[ndarray, "T V 3"], wrist: Float[ndarray, "3"], pose: Float[ndarray, "T 45"]
) -> tuple[Float[ndarray, "V 3"], Float[ndarray, "16 3"], Float[ndarray, "V 16"]] | None:
    """Vertices and joints [m] of the flat hand, and weights that give each vertex to one bone.

    ``x`` are the moving vertices in the hand frame, ``wrist`` the place of the wrist joint there, ``pose`` rotation
    vectors relative to the flat hand. None where some bone turns too little to be told.
    """
    T, V = x.shape[:2]
    A = np.tile(np.eye(3), (T, 16, 1, 1))
    for bone, turn in enumerate(np.moveaxis(se3.exp_so3(pose.reshape(T, 15, 3)), 1, 0), start=1):
        A[:, bone] = A[:, PARENTS[bone]] @ turn
    mean = se3.nearest_rotation(A.mean(axis=0))
    if np.sqrt((se3.angle_between(A, mean[None]) ** 2).mean(axis=0))[1:].min() < LEAST_TURN:
        return None
    joints, place = np.tile(wrist, (16, 1)), np.tile(wrist, (16, T, 1))
    flat = np.tile(x.mean(axis=0), (16, 1, 1))
    error = np.zeros((16, V))
    error[0] = _rms(x - flat[0])
    for bone in range(1, 16):
        parent = PARENTS[bone]
        B, moved = A[:, parent], x - place[parent][:, None]
        offset, own, error[bone] = _placed(moved, B, A[:, bone])
        joints[bone] = joints[parent] + offset
        place[bone] = place[parent] + B @ offset
        flat[bone] = joints[bone] + own
    nearest = error.argmin(axis=0)
    return flat[nearest, np.arange(V)], joints, np.eye(16)[nearest]


def _placed(
    moved: Float[ndarray, "T V 3"], B: Float[ndarray, "T 3 3"], A: Float[ndarray, "T 3 3"]
) -> tuple[Float[ndarray, "3"], Float[ndarray, "V 3"], Float[ndarray, "V"]]:
    """The offset of a joint, each vertex's own if it follows the bone, and how far the vertex then is, rms [m]."""
    to_parent, to_bone = np.swapaxes(B, 1, 2), np.swapaxes(A, 1, 2)
    of_parent = (moved @ B).mean(axis=0)  # what B alone explains, and what A alone does
    of_bone = (moved @ A).mean(axis=0)
    mixed, ridged = (to_parent @ A).mean(axis=0), 1.0 + RIDGE
    schur = np.eye(3) - mixed @ mixed.T / ridged
    offsets = np.linalg.solve(schur, (of_parent - of_bone @ mixed.T / ridged).T).T
    own = (of_bone - offsets @ mixed) / ridged
    alone = _rms(moved - of_parent @ to_parent)
    both = _rms(moved - offsets @ to_parent - own @ to_bone)
    ratio = np.where(alone > MOVES, both / np.maximum(alone, MOVES), np.inf)
    followers = np.argsort(ratio, kind="stable")[:FOLLOWERS]
    offset = offsets[followers].mean(axis=0)
    own = (of_bone - offset @ mixed) / ridged
    return offset, own, _rms(moved - offset @ to_parent[:, None] - own @ to_bone)


def _rms(difference: Float[ndarray, "T V 3"]) -> Float[ndarray, "V"]:
    return np.asarray(np.sqrt((difference**2).sum(axis=-1).mean(axis=0)))

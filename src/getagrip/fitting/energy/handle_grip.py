"""The handle in the hand: energy is saved where it lies within the fingers.

A handle taken for a spout, or a mug turned front to back, may explain the masks as well as the true pose does. The hand
tells them apart: fingers that hold a handle have its bar at the middle of their joints. The saving ends a little beside
it, so that nothing changes where the hand holds the body.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import HandTrack
from getagrip.compiling import kernel
from getagrip.fitting.energy.contact import add_rank_one, mirror_upper
from getagrip.fitting.energy.term import PosesInCamera, Quadratic
from getagrip.geometry import se3

FIRST_FINGER_JOINT, N_FINGERS, N_FINGER_JOINTS = 5, 4, 4
"""Joints of index to little finger among a hand's 21, after wrist and thumb."""


def finger_middles(hand: HandTrack) -> Float[ndarray, "T 4 3"] | None:
    """Return the mean joint of each finger but the thumb, in the camera frame [m]; None of a hand without joints."""
    if hand.joints is None:
        return None
    joints = se3.transform(hand.T_cam_hand, hand.joints[:, FIRST_FINGER_JOINT:])
    return np.asarray(joints.reshape(-1, N_FINGERS, N_FINGER_JOINTS, 3).mean(axis=2))


@dataclass(frozen=True)
class HandleTerm:
    """``-weight * mean over the two nearest fingers of max(0, reach - max(0, d - slack))``.

    d is the distance of a finger's middle from the handle's line. Two fingers count: small handles hold no more.
    """

    line: Float[ndarray, "P 3"]
    """Points of the handle's middle line about the mesh's centre, unscaled [m]."""
    fingers: Float[ndarray, "N 4 3"]
    """Middles of the fingers in the camera frame [m]."""
    weight: Float[ndarray, "N"]
    """Energy per metre, per frame [px^2 / m]."""
    slack: float = 0.01
    """Distance that costs nothing [m]."""
    reach: float = 0.015
    """Further distance at which the saving ends [m]: handles in hands are up to 20 mm off, held bodies' from 25 mm."""
    delta: float = 0.002
    """Distances below this count as this in the curvature [m]."""
    name: str = "handle"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        found = Quadratic.zero(poses)
        _evaluate_handle(
            poses.R, poses.centre, poses.scale, self.line, self.fingers, self.weight, self.slack, self.reach,
            self.delta, found.value, found.g, found.H,
        )  # fmt: skip
        return found


@kernel("f4 f3 f1 f2 f3 f1 f f f f2 f3 f4")
def _evaluate_handle(R, centre, scale, line, fingers, weight, slack, reach, delta, value, g, H):
    """Fill in value (B, N), g (B, N, 7), H (B, N, 7, 7)."""
    B, N = value.shape
    P, F = len(line), fingers.shape[1]
    at, off, distance = np.empty((P, 3)), np.empty((F, 6)), np.empty(F)
    a = np.empty(7)
    for b in range(B):
        for n in range(N):
            for p in range(P):
                for k in range(3):
                    at[p, k] = scale[b] * (
                        R[b, n, k, 0] * line[p, 0] + R[b, n, k, 1] * line[p, 1] + R[b, n, k, 2] * line[p, 2]
                    )
            for f in range(F):
                distance[f] = np.inf
                for p in range(P):
                    x = at[p, 0] + centre[b, n, 0] - fingers[n, f, 0]
                    y = at[p, 1] + centre[b, n, 1] - fingers[n, f, 1]
                    z = at[p, 2] + centre[b, n, 2] - fingers[n, f, 2]
                    d = np.sqrt(x * x + y * y + z * z)
                    if d < distance[f]:
                        distance[f] = d
                        off[f, 0], off[f, 1], off[f, 2] = x, y, z
                        off[f, 3], off[f, 4], off[f, 5] = at[p, 0], at[p, 1], at[p, 2]
            for _ in range(2):
                f = int(np.argmin(distance))
                d = distance[f]
                distance[f] = np.inf
                excess = d - slack
                if not excess < reach:
                    continue
                value[b, n] -= 0.5 * weight[n] * (reach - max(excess, 0.0))
                if excess <= 0.0:
                    continue
                x, y, z = off[f, 0] / d, off[f, 1] / d, off[f, 2] / d
                r0, r1, r2 = off[f, 3], off[f, 4], off[f, 5]
                a[0], a[1], a[2] = x, y, z
                a[3], a[4], a[5] = r1 * z - r2 * y, r2 * x - r0 * z, r0 * y - r1 * x
                a[6] = r0 * x + r1 * y + r2 * z
                slope = 0.5 * weight[n]
                add_rank_one(slope, slope / max(excess, delta), a, g[b, n], H[b, n])
            mirror_upper(H[b, n])

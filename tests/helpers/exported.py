"""A result of a small clip, to export."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from getagrip.clip import Clip, World
from getagrip.geometry import se3
from getagrip.result import Axis, Candidates, Reconstruction, Status
from helpers.clips import small_clip

TURN = np.array([[0.0, 0.1, 3.0], [0.0, 0.2, 3.1], [0.0, 0.3, 3.2]])
"""Rotation vectors that go through half a turn, where quaternions change their signs."""


def result_and_clip() -> tuple[Reconstruction, Clip]:
    """The result is of the last three of five frames."""
    clip, _ = small_clip(5)
    turned = se3.rigid(se3.exp_so3(np.array([[0.1 * n, 2.0, 0.3] for n in range(5)])), np.array([[1.0, 2.0, 3.0]] * 5))
    clip = replace(clip, times=np.array([7.0, 7.1, 7.2, 7.3, 7.5]), world=World(turned, np.array([0.0, 1.0, 0.0])))
    T = se3.rigid(se3.exp_so3(TURN), np.array([[0.01, 0.02, 0.03]] * 3))
    result = Reconstruction(
        clip=clip.name,
        method="soft-hinge",
        frames=clip.frames[2:],
        T_hand_obj=T,
        scale=1.25,
        iou=np.array([0.9, 0.8, np.nan]),
        frame_kind=("sampled", "fitted", "interpolated"),
        axis=Axis(np.zeros(3), np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.1, 0.2])),
        candidates=Candidates(T[None], np.array([1.25]), np.array([2.0])),
        energy={"total": 2.0},
        status=Status.CONVERGED,
        ambiguous=False,
        seconds={"total": 0.1},
        notes=("the scale is a guess",),
    )
    return result, clip

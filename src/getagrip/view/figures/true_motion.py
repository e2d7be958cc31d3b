"""The ground truth of a clip as a view, with the axis nearest to its motion: what the paper's Fig. 2 and 3 show."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from getagrip.clip import read_clip
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.grasps.approximation import pose_hinge
from getagrip.grasps.study import object_in_hand
from getagrip.result import Axis, Candidates, Reconstruction, Status
from getagrip.view.shown import View


def true_view(folder: Path) -> View:
    """All frames of a clip, the hand and the object where they truly are. Raises ``InputError``.

    The axis is that of the hinge of least error, which the study measures too (``pose_hinge``).
    """
    clip = read_clip(folder).light()
    truth = clip.truth
    if truth is None:
        raise InputError(folder / "truth.npz", "", "no such file", "the true poses, or a result instead of a clip")
    R, centre, size = object_in_hand(clip)
    hinge = pose_hinge(R, centre, size)
    T_hand_obj = se3.inverse(truth.T_cam_hand) @ truth.T_cam_obj
    motion = Reconstruction(
        clip=clip.name,
        method="one-dof",
        frames=clip.frames,
        T_hand_obj=T_hand_obj,
        scale=truth.scale,
        iou=np.ones(len(clip)),
        axis=Axis(hinge.point, hinge.direction, np.unwrap(hinge.angles(R, centre))),
        candidates=Candidates(T_hand_obj[None], np.array([truth.scale]), np.zeros(1)),
        energy={},
        status=Status.GIVEN,
        ambiguous=False,
        seconds={},
    )
    hand = replace(clip.hand, vertices=truth.hand_vertices, T_cam_hand=truth.T_cam_hand)
    return View(replace(clip, hand=hand, scale="known"), None, motion, of_truth=True)

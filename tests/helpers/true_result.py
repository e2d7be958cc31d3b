"""The ground truth of a clip as a result."""

from __future__ import annotations

import numpy as np

from getagrip.clip import Clip
from getagrip.geometry import se3
from getagrip.result import Axis, Candidates, Reconstruction, Status


def true_result(clip: Clip, axis: Axis | None) -> Reconstruction:
    """A result of ``one-dof``; without an axis, of ``static``. Its IOU is made up."""
    assert clip.truth is not None
    T = se3.inverse(clip.truth.T_cam_hand) @ clip.truth.T_cam_obj
    return Reconstruction(
        clip=clip.name,
        method="static" if axis is None else "one-dof",
        frames=clip.frames,
        T_hand_obj=T,
        scale=clip.truth.scale,
        iou=np.linspace(0.5, 1.0, len(clip)),
        axis=axis,
        candidates=Candidates(T[None], np.ones(1), np.ones(1)),
        energy={"total": 1.0},
        status=Status.CONVERGED,
        ambiguous=True,
        seconds={"total": 0.5},
    )

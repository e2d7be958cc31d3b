"""Curves of a result over time: the object's angle in the hand, and the times of the frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.pictures.shown import View


@dataclass(frozen=True, eq=False)
class AngleCurve:
    """An angle of the object in each of T frames [rad], of the result and, where it is known, of the ground truth."""

    title: str
    """Name of the angle."""
    found: Float[ndarray, "T"]
    true: Float[ndarray, "T"] | None


def seconds(view: View) -> Float[ndarray, "T"]:
    """Return the times of the frames since the first."""
    times = view.clip.time[view.clip.index_of(view.result.frames)]
    return np.asarray(times - times[0])


def angle_curve(view: View) -> AngleCurve:
    """Return the angle about the axis, less its mean; or, without an axis, of the rotation since the first frame."""
    result, truth = view.result, view.clip.truth
    true = None if truth is None else (se3.inverse(truth.T_cam_hand) @ truth.T_cam_obj)[:, :3, :3]
    if result.axis is None:
        R = result.T_hand_obj[:, :3, :3]
        turned = [None if r is None else se3.angle_between(r[:1], r) for r in (R, true)]
        assert turned[0] is not None
        which = "" if view.clip.other_hand is None else f"{view.clip.side} "
        return AngleCurve(f"rotation in the {which}hand since the start", turned[0], turned[1])
    found, about = result.axis.angle - result.axis.angle.mean(), None
    if true is not None:
        about = se3.log_so3(true @ true[0].T) @ result.axis.direction
        about -= about.mean()
    return AngleCurve("angle of the object about the axis", found, about)

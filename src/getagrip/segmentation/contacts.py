"""Stable grasps within held segments: Eq. 2 on the contacts of a reconstruction."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from scipy.ndimage import gaussian_filter1d

from getagrip.clip import Clip, Truth
from getagrip.geometry import se3
from getagrip.grasps.definition import Definition
from getagrip.grasps.stable import segment
from getagrip.segmentation.held import Held

STEADIED = 0.067
"""Fingers are smoothed in time by a Gaussian of this standard deviation [s]: those of trackers tremble, and with them
what they touch."""


@dataclass(frozen=True)
class Reconstructed:
    """An object in some frames that follow each other: as a hand holds it, and as it lies before and after.

    Attributes:
        frames: (n,) the frames.
        held: (n,) in which of them it is held.
        T_cam_obj: (n, 4, 4) poses of the object.
        T_cam_hand: (n, 4, 4) poses of the hand.
        scale: of the object.
    """

    frames: Int[ndarray, "n"]
    held: Bool[ndarray, "n"]
    T_cam_obj: Float[ndarray, "n 4 4"]
    T_cam_hand: Float[ndarray, "n 4 4"]
    scale: float


def reconstructed(clip: Clip, fit: Held, first: int, last: int, still_before: int, still_after: int) -> Reconstructed:
    """A fit in its segment, and the object left lying in the world in so many frames before and after.

    Where the fit was tried in those, too, the hand is where it has it, else where the clip has it.
    """
    frames = np.arange(first - still_before, last + 1 + still_after)
    inside = (fit.frames >= first) & (fit.frames <= last)
    T_world_cam = np.tile(np.eye(4), (len(clip), 1, 1)) if clip.world is None else clip.world.T_world_cam
    T_world_obj = T_world_cam[first : last + 1] @ fit.T_cam_obj[inside]
    nearest = np.clip(frames, first, last) - first
    T_cam_obj = se3.inverse(T_world_cam[frames]) @ T_world_obj[nearest]
    T_cam_obj[still_before : still_before + last + 1 - first] = fit.T_cam_obj[inside]
    T_cam_hand = clip.hand.T_cam_hand.copy()
    T_cam_hand[fit.frames] = fit.T_cam_hand
    return Reconstructed(frames, (frames >= first) & (frames <= last), T_cam_obj, T_cam_hand[frames], fit.scale)


def stable_in(clip: Clip, found: Reconstructed, definition: Definition) -> list[tuple[int, int]]:
    """First and last frame of each stable grasp (Eq. 2) that has a frame in which the object is held."""
    part = clip.take(found.frames)
    fingers = gaussian_filter1d(part.hand.vertices, STEADIED * clip.fps, axis=0, mode="nearest")
    posed = Truth(found.T_cam_obj, found.scale, found.T_cam_hand, fingers)
    _, grasps = segment(replace(part, truth=posed), definition)
    return [
        (int(found.frames[first]), int(found.frames[last]))
        for first, last in grasps
        if found.held[first : last + 1].any()
    ]

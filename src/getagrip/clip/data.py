"""A clip: one stable grasp, with its hands, masks, camera and object."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.mesh import Mesh

FINGERS = ("thumb", "index", "middle", "ring", "pinky")


@dataclass(frozen=True)
class HandTrack:
    """A hand in every frame (``hand.npz``)."""

    vertices: Float[ndarray, "T V 3"]
    """Vertices in the hand frame [m]."""
    faces: Int[ndarray, "F 3"]
    """Faces, outward."""
    T_cam_hand: Float[ndarray, "T 4 4"]
    """Hand frame to camera."""
    regions: dict[str, Int[ndarray, "_"]]
    """Contact regions as vertex ids: the five ``FINGERS`` (pads of the fingertips), then ``palm_*``."""
    joints: Float[ndarray, "T 21 3"] | None = None
    """Joints in the hand frame [m]: wrist, then thumb, index, middle, ring, pinky, each from the palm to the tip."""


@dataclass(frozen=True)
class Truth:
    """What really happened (``truth.npz``)."""

    T_cam_obj: Float[ndarray, "T 4 4"]
    scale: float
    T_cam_hand: Float[ndarray, "T 4 4"]
    """The true hand; the clip's own where the file has none."""
    hand_vertices: Float[ndarray, "T V 3"]
    articulation: Float[ndarray, "T"] | None = None
    """Angle of the object's joint [rad], where it has one."""


@dataclass(frozen=True)
class Masks:
    """What is seen of the object, and where a pixel says nothing about it."""

    object: Bool[ndarray, "T H W"]
    ignore: Bool[ndarray, "T H W"]


@dataclass(frozen=True)
class Clip:
    """One stable grasp, checked; masks are read only by the steps that need them (``read_masks``)."""

    folder: Path
    name: str
    category: str
    side: Literal["left", "right"]
    fps: float
    frames: tuple[str, ...]
    """Names of the mask and image files, in order."""
    size: tuple[int, int]
    """Width and height of the images [px]."""
    K: Float[ndarray, "T 3 3"]
    """Pinhole intrinsics of each frame [px]."""
    mesh: Mesh
    scale: Literal["known", "free"]
    hand: HandTrack
    truth: Truth | None = None
    provenance: dict[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.frames)

    def take(self, index: Int[ndarray, "n"]) -> Clip:
        """The clip at some of its frames, in the given order."""
        hand = replace(
            self.hand,
            vertices=self.hand.vertices[index],
            T_cam_hand=self.hand.T_cam_hand[index],
            joints=None if self.hand.joints is None else self.hand.joints[index],
        )
        truth = self.truth and replace(
            self.truth,
            T_cam_obj=self.truth.T_cam_obj[index],
            T_cam_hand=self.truth.T_cam_hand[index],
            hand_vertices=self.truth.hand_vertices[index],
            articulation=None if self.truth.articulation is None else self.truth.articulation[index],
        )
        frames = tuple(self.frames[i] for i in index)
        return replace(self, frames=frames, K=self.K[index], hand=hand, truth=truth)


def seen_frames(clip: Clip, masks: Masks) -> tuple[Clip, Masks, tuple[str, ...]]:
    """The clip and its masks without the frames in which nothing of the object is seen, and their names.

    Raises ``InputError`` when fewer than two frames are left: one silhouette says nothing about a motion.
    """
    seen = np.flatnonzero((masks.object & ~masks.ignore).any(axis=(1, 2)))
    if len(seen) == len(clip):
        return clip, masks, ()
    if len(seen) < 2:
        given = f"{len(seen)} of {len(clip)} masks with a pixel that is not ignored"
        raise InputError(clip.folder / "masks" / "object", "", given, "at least 2")
    dropped = tuple(name for n, name in enumerate(clip.frames) if n not in set(seen))
    return clip.take(seen), Masks(masks.object[seen], masks.ignore[seen]), dropped

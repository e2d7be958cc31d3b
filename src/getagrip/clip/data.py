"""A clip: one stable grasp, with its hands, masks, camera and object."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry.mesh import Mesh

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

    @property
    def seen(self) -> Bool[ndarray, "T"]:
        """Frames in which a pixel of the object is not ignored."""
        return np.asarray((self.object & ~self.ignore).any(axis=(1, 2)))

    def take(self, index: Int[ndarray, "n"]) -> Masks:
        """The masks of some of the frames, in the given order."""
        return Masks(self.object[index], self.ignore[index])


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
    left_out: tuple[str, ...] = ()
    """Names of frames that are gone because nothing of the object is seen in them (``seen_frames``)."""

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


def seen_frames(clip: Clip, seen: Bool[ndarray, "T"]) -> Clip:
    """The clip at the frames in which something of the object is seen.

    Raises ``InputError`` for fewer than two: one silhouette says nothing about a motion.
    """
    if seen.sum() < 2:
        given = f"{seen.sum()} of {len(clip)} masks with a pixel that is not ignored"
        raise InputError(clip.folder / "masks" / "object", "", given, "at least 2")
    unseen = tuple(name for name, is_seen in zip(clip.frames, seen, strict=True) if not is_seen)
    return replace(clip.take(np.flatnonzero(seen)), left_out=(*clip.left_out, *unseen))

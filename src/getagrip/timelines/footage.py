"""A clip and its masks, and problems at any of its frames that show the object."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.checks.evidence import Glitches
from getagrip.clip import Clip, Masks, Segment, World
from getagrip.fitting.options import Options
from getagrip.fitting.problem import Problem, prepare
from getagrip.fitting.tracker_glitches import repair_hand
from getagrip.geometry import se3


def grasp_clip(clip: Clip, masks: Masks, segment: Segment) -> tuple[Clip, Masks, Int[ndarray, "n"]] | None:
    """A grasp as a clip of the hand that holds the object, its masks, and its frames: those in which the hand is known.

    None where fewer than two of them show the object. The other hand's pixels are not known apart from all ignored.
    """
    by, rows = clip.with_side(segment.side), segment.rows[clip.hand_known(segment.side)[segment.rows]]
    if by is None or not len(rows):
        return None
    of_grasp = masks.take(rows)
    if of_grasp.observed.sum() < 2:
        return None
    return by.take(rows), of_grasp if by is clip else replace(of_grasp, hand=None), rows


@dataclass(frozen=True)
class Footage:
    """What a timeline is reconstructed from. The clip's scale is known; its hand is as it was given, where it does not
    jump."""

    clip: Clip
    masks: Masks
    options: Options
    some: Problem
    """At a few of the frames; others are made from it."""
    glitches: Glitches | None = None

    @staticmethod
    def of(clip: Clip, masks: Masks, options: Options) -> Footage:
        """Without a world, the camera's own frame stands for one.

        Raises ``InputError`` where the object is visible in fewer than two frames.
        """
        if clip.world is None:
            clip = replace(clip, world=World(np.tile(np.eye(4), (len(clip), 1, 1))))
        clip, glitches = repair_hand(clip, options)
        return Footage(
            clip, masks, options, prepare(clip, masks, replace(options, frames=2, hands="as-given")), glitches
        )

    def __len__(self) -> int:
        return len(self.clip)

    @property
    def T_world_cam(self) -> Float[ndarray, "T 4 4"]:
        """Where the camera was."""
        assert self.clip.world is not None
        return self.clip.world.T_world_cam

    @property
    def T_cam_world(self) -> Float[ndarray, "T 4 4"]:
        """The world before the camera."""
        return se3.inverse(self.T_world_cam)

    @property
    def T_world_hand(self) -> Float[ndarray, "T 4 4"]:
        """The given hand in the world."""
        return self.T_world_cam @ self.clip.hand.T_cam_hand

    def carried(self, before: int, after: int) -> list[Float[ndarray, "4 4"]]:
        """What moves with a given hand from one frame to another, moves so in the world: by the clip's own hand, and by
        the other one if it is known in both frames."""
        T_world_hands, other = [self.T_world_hand], self.clip.other_hand
        if other is not None and other.known[before] and other.known[after]:
            T_world_hands.append(self.T_world_cam @ other.track.T_cam_hand)
        return [T[after] @ se3.inverse(T[before]) for T in T_world_hands]

    def grasp_clip(self, segment: Segment) -> tuple[Clip, Masks, Int[ndarray, "n"]] | None:
        """A grasp as a clip (``held``)."""
        return grasp_clip(self.clip, self.masks, segment)

    def observed(self, rows: Int[ndarray, "n"]) -> Int[ndarray, "m"]:
        """Those of some frames whose masks show the object."""
        return rows[self.masks.take(rows).observed]

    def problem(self, rows: Int[ndarray, "n"]) -> Problem:
        """At frames that show the object, in the given order, with the hand as it was given."""
        return self.some.at(self.clip.take(rows), self.masks.take(rows))

"""The inputs of a timeline, its grasps as clips of their own, and hypotheses about the object's poses in the world."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import Clip, Masks, Segment, World, read_masks, with_masks
from getagrip.errors import UsageError
from getagrip.fitting.methods.all_frames import soft_hinges
from getagrip.fitting.motion import PosesInHand, hand_object_transforms
from getagrip.fitting.options import Options
from getagrip.fitting.pipeline import RepairedInput
from getagrip.fitting.problem import Problem, prepare_problem
from getagrip.geometry import se3

TIMELINE_METHOD = "soft-hinge"
"""Method that solves the grasps of a timeline."""


@dataclass(frozen=True)
class TimelineInputs:
    """The inputs of a timeline's reconstruction.

    Attributes:
        source: the clip as read, and its repaired hand.
        clip: the clip at its scale, with the repaired hand and a world: the camera frame where the clip has none.
        masks: the clip's masks.
        scale: scale of the clip's mesh.
        some: the problem at two frames; problems at other frames are made from it.
        T_world_cam: (T, 4, 4) poses of the camera.
        T_cam_world: (T, 4, 4) their inverses.
        shown: (T,) frames whose masks show the object.
    """

    source: RepairedInput
    clip: Clip
    masks: Masks
    scale: float
    some: Problem
    T_world_cam: Float[ndarray, "T 4 4"]
    T_cam_world: Float[ndarray, "T 4 4"]
    shown: Bool[ndarray, "T"]

    @staticmethod
    def of(source: RepairedInput) -> TimelineInputs:
        """Read the masks unless the clip holds them, and estimate a free scale.

        Raises ``UsageError`` for methods other than the soft hinge, ``InputError`` where the object is visible in
        fewer than two frames.
        """
        clip, options, scale = source.clip, source.options, 1.0
        if options.method != TIMELINE_METHOD:
            raise UsageError(f"method must be {TIMELINE_METHOD!r} for a clip with segments (got {options.method!r})")
        masks = read_masks(clip)
        clip = with_masks(clip, masks)
        if clip.scale == "free":
            scale = find_scale(clip, options)
            clip = replace(clip.resized(scale), scale="known", truth=None)
        world = clip.world or World(np.tile(np.eye(4), (len(clip), 1, 1)))
        clip = replace(clip, world=world)
        some = prepare_problem(clip, replace(options, frames=2, hands="as-given"))
        T_world_cam = world.T_world_cam
        return TimelineInputs(source, clip, masks, scale, some, T_world_cam, se3.inverse(T_world_cam), masks.observed)

    def __len__(self) -> int:
        return len(self.clip)

    def problem(self, rows: Int[ndarray, "n"]) -> Problem:
        """Make the problem at ``rows``, in this order, with the repaired hand; all must show the object."""
        return self.some.at(self.clip.take(rows))


@dataclass(frozen=True)
class GraspClip:
    """A grasp as a clip of the grasping hand, at the frames in which this hand is known.

    Attributes:
        rows: indices of these frames in the timeline.
    """

    segment: Segment
    clip: Clip
    rows: Int[ndarray, "n"]

    @staticmethod
    def of(clip: Clip, segment: Segment) -> GraspClip | None:
        """Cut a grasp out of a clip with masks; None where fewer than two frames show the object.

        A grasp by the other hand has no hand mask: the ignore mask holds the pixels of both hands.
        """
        by, rows = clip.with_side(segment.side), segment.rows[clip.hand_known(segment.side)[segment.rows]]
        if by is None or not len(rows):
            return None
        of_grasp = by.take(rows)
        masks = read_masks(of_grasp)
        if masks.observed.sum() < 2:
            return None
        return GraspClip(segment, of_grasp if by is clip else with_masks(of_grasp, replace(masks, hand=None)), rows)


def find_scale(clip: Clip, options: Options) -> float:
    """Estimate the object's scale from the longest grasp, where hand and camera determine it.

    Raises ``InputError``.
    """
    grasps = [GraspClip.of(clip, segment) for segment in clip.segments if segment.state == "grasp"]
    longest = max((grasp for grasp in grasps if grasp is not None), key=lambda grasp: len(grasp.rows), default=None)
    problem = prepare_problem(longest.clip if longest else clip, options)
    return float(soft_hinges(problem, lambda _: None).motion.poses().scale[0])


@dataclass(frozen=True)
class Hypotheses(PosesInHand):
    """K solutions in n frames of a clip, best first; poses are in the world frame.

    Attributes:
        energy: (K,) energy of each solution [px^2 of the 256-pixel crop].
    """

    energy: Float[ndarray, "K"]

    def at(self, frames: Int[ndarray, "m"]) -> Hypotheses:
        """Return the hypotheses at ``frames``."""
        return Hypotheses(self.R[:, frames], self.centre[:, frames], self.scale, self.energy)

    def T_world_obj(self, centre: Float[ndarray, "3"]) -> Float[ndarray, "K n 4 4"]:
        """Return the poses of the mesh's own frame, in which ``centre`` is the mesh's centre."""
        return hand_object_transforms(self, centre)

    @staticmethod
    def of_pose(T_world_obj: Float[ndarray, "4 4"], centre: Float[ndarray, "3"]) -> Hypotheses:
        """Make the hypothesis of one known pose in one frame, at scale 1 and energy 0."""
        placed_centre = se3.transform(T_world_obj, centre[None])
        return Hypotheses(T_world_obj[None, None, :3, :3], placed_centre[None], np.ones(1), np.zeros(1))

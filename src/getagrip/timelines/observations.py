"""A timeline's clip and its masks, and problems at any of its frames that show the object.

Hypotheses about the object in some frames of a timeline: a few distinct solutions, in the world.
"""

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
from getagrip.geometry.mesh import Mesh

TIMELINE_METHOD = "soft-hinge"
"""How objects move in the grasps of a timeline."""


@dataclass(frozen=True)
class TimelineInputs:
    """The inputs of a timeline's reconstruction.

    Attributes:
        source: the clip as it came.
        clip: the clip at its scale, its hand repaired, with a world: without one, the camera's own frame stands for it.
        masks: those of the clip.
        scale: of the mesh that was given.
        some: the problem at a few of the frames, from which others are made.
        T_world_cam: (T, 4, 4) poses of the camera.
        T_cam_world: (T, 4, 4) of the world before it.
        shown: (T,) the frames whose masks show the object.
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
        """Read masks that were not given, and find a free scale.

        Raises ``UsageError`` for another method than the soft hinge, ``InputError`` where the object is visible in
        fewer than two frames.
        """
        clip, options, scale = source.clip, source.options, 1.0
        if options.method != TIMELINE_METHOD:
            raise UsageError(f"method must be {TIMELINE_METHOD!r} for a clip with segments (got {options.method!r})")
        masks = read_masks(clip)
        clip = with_masks(clip, masks)
        if clip.scale == "free":
            scale = find_scale(clip, options)
            clip = replace(clip, mesh=Mesh(scale * clip.mesh.vertices, clip.mesh.faces), scale="known", truth=None)
        world = clip.world or World(np.tile(np.eye(4), (len(clip), 1, 1)))
        clip = replace(clip, world=world)
        some = prepare_problem(clip, replace(options, frames=2, hands="as-given"))
        T_world_cam = world.T_world_cam
        return TimelineInputs(source, clip, masks, scale, some, T_world_cam, se3.inverse(T_world_cam), masks.observed)

    def __len__(self) -> int:
        return len(self.clip)

    def problem(self, rows: Int[ndarray, "n"]) -> Problem:
        """Make the problem at frames that show the object, in the given order, with the repaired hand."""
        return self.some.at(self.clip.take(rows))


@dataclass(frozen=True)
class GraspClip:
    """A grasp as a clip of the hand that holds the object, in the frames in which that hand is known.

    Attributes:
        rows: these frames, of the timeline.
    """

    segment: Segment
    clip: Clip
    rows: Int[ndarray, "n"]

    @staticmethod
    def of(clip: Clip, segment: Segment) -> GraspClip | None:
        """Make the grasp of a clip with its masks; None where fewer than two of its frames show the object.

        The other hand's pixels are not known apart from all ignored.
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
    """Return the object's scale: that of the longest grasp, where hand and camera determine it.

    Raises ``InputError``.
    """
    grasps = [GraspClip.of(clip, segment) for segment in clip.segments if segment.state == "grasp"]
    longest = max((grasp for grasp in grasps if grasp is not None), key=lambda grasp: len(grasp.rows), default=None)
    problem = prepare_problem(longest.clip if longest else clip, options)
    return float(soft_hinges(problem, lambda _: None).motion.poses().scale[0])


@dataclass(frozen=True)
class Hypotheses(PosesInHand):
    """K solutions in n frames of a clip, best first; the poses are in the world.

    Attributes:
        energy: of each [px^2 of the 256-pixel crop].
    """

    energy: Float[ndarray, "K"]

    def at(self, frames: Int[ndarray, "m"]) -> Hypotheses:
        """Return the hypotheses at some of the frames."""
        return Hypotheses(self.R[:, frames], self.centre[:, frames], self.scale, self.energy)

    def T_world_obj(self, centre: Float[ndarray, "3"]) -> Float[ndarray, "K n 4 4"]:
        """Return poses of the mesh's own frame, in which its centre is where it is given."""
        return hand_object_transforms(self, centre)

    @staticmethod
    def of_pose(T_world_obj: Float[ndarray, "4 4"], centre: Float[ndarray, "3"]) -> Hypotheses:
        """Make the hypothesis of one known pose in one frame, at the scale of the mesh."""
        placed_centre = se3.transform(T_world_obj, centre[None])
        return Hypotheses(T_world_obj[None, None, :3, :3], placed_centre[None], np.ones(1), np.zeros(1))

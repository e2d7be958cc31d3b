"""Predict each frame's silhouette from its neighbours, ignoring its own mask.

In a grasp the object moves little in the hand from frame to frame, and smoothly before the camera. So its silhouette is
predicted twice: from the typical pose in the hand, that of a few neighbours which is nearest to the others, and from
the pose between the nearest other frames, in the camera frame. The first is wrong where the hand is wrong, the second
where the motion is fast or a neighbour's mask is wrong. A frame's own pose does not count: deviations from a motion,
and the angle about a far axis, may well follow a wrong mask.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.fitting.image_iou import MaskOverlap, mask_overlap
from getagrip.fitting.motion import Free, PosesInHand, hand_object_transforms, interpolate_object_poses, transform_poses
from getagrip.fitting.problem import Problem
from getagrip.geometry import se3

N_NEIGHBOUR_FRAMES = 6
"""Number of frames on either side, beside the frame itself, that determine the typical pose."""


@dataclass(frozen=True)
class NeighbourPrediction:
    """A prediction of each frame's pose from its neighbours' poses.

    Attributes:
        typical: (1, n) the typical pose in the hand of each frame and its neighbours.
        in_camera: (1, n) the poses of the frames, in the camera frame.
        at: (n,) places of the frames in their clip, at least 3.
    """

    typical: PosesInHand
    in_camera: PosesInHand
    at: Int[ndarray, "n"]

    @staticmethod
    def by(problem: Problem, poses: PosesInHand, at: Int[ndarray, "n"]) -> NeighbourPrediction:
        """Predict from the best of the poses in a problem's frames, which are ``at`` these places."""
        best = poses.take(np.zeros(1, dtype=int))
        return NeighbourPrediction(
            medoid_poses(best, problem.surface.points), transform_poses(best, problem.clip.hand.T_cam_hand), at
        )

    def overlap(self, problem: Problem, at: Int[ndarray, "m"]) -> MaskOverlap:
        """Compare the masks of a problem's frames, which are ``at`` these places, with the predicted silhouettes.

        Of the two silhouettes, the one that differs less.
        """
        clip, centre, scale = problem.clip, problem.clip.mesh.centre, float(self.typical.scale[0])
        in_hand = interpolate_object_poses(self.typical, self.at, at)
        between = transform_poses(self.between(at), se3.inverse(clip.hand.T_cam_hand))
        one, two = (
            mask_overlap(clip, problem.masks, hand_object_transforms(poses, centre)[0], scale)
            for poses in (in_hand, between)
        )
        first = one.differing <= two.differing
        return MaskOverlap(*(np.where(first, x, y) for x, y in zip(one, two, strict=True)))

    def between(self, at: Int[ndarray, "m"]) -> PosesInHand:
        """Interpolate the pose in the camera frame between the nearest other frames; extrapolate it at the ends."""
        R, centre = np.empty((1, len(at), 3, 3)), np.empty((1, len(at), 3))
        for m, place in enumerate(at):
            R[0, m], centre[0, m] = self._from_others(place)
        return PosesInHand(R, centre, self.in_camera.scale)

    def _from_others(self, place: int) -> tuple[Float[ndarray, "3 3"], Float[ndarray, "3"]]:
        others = np.flatnonzero(self.at != place)
        known = Free(self.in_camera.R[:, others], self.in_camera.centre[:, others], np.log(self.in_camera.scale))
        found = known.resampled(self.at[others], np.array([place]))
        return found.R[0, 0], found.centre[0, 0]


def medoid_poses(poses: PosesInHand, points: Float[ndarray, "P 3"]) -> PosesInHand:
    """Choose in each frame, for one hypothesis, the pose among it and its neighbours that is nearest to all of them."""
    x = float(poses.scale[0]) * points @ np.swapaxes(poses.R[0], -1, -2) + poses.centre[0, :, None]
    apart = np.sqrt(np.mean(np.sum((x[:, None] - x[None]) ** 2, axis=-1), axis=-1))
    frame = np.arange(len(x))
    near = [np.flatnonzero(np.abs(frame - n) <= N_NEIGHBOUR_FRAMES) for n in frame]
    chosen = [some[apart[np.ix_(some, some)].sum(axis=1).argmin()] for some in near]
    return PosesInHand(poses.R[:, chosen], poses.centre[:, chosen], poses.scale)

"""An object's motion over a timeline, as it is filled in."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import Clip, Segment
from getagrip.clip.timeline import Side
from getagrip.geometry import se3
from getagrip.result import FrameKind
from getagrip.timelines.grasp_segment import GraspTrack
from getagrip.timelines.hypotheses import Hypotheses


@dataclass
class TimelineMotion:
    """An object's motion over a clip, as it is filled in; frames that are not yet known are NaN.

    Attributes:
        side: of the clip's own hand.
        centre: (3,) of the mesh, in its own frame.
        T_world_cam: (T, 4, 4) poses of the camera.
        shown: (T,) the frames whose masks show the object.
        T_cam_obj: (T, 4, 4) poses of the mesh's own frame in the camera frame.
        T_cam_hands: (T, 4, 4) poses of each known hand, by its side, corrected in its grasps.
        kind: how each frame's pose was found.
        grasps: the grasps that were solved as such, by their segment's first frame.
    """

    side: Side
    centre: Float[ndarray, "3"]
    T_world_cam: Float[ndarray, "T 4 4"]
    shown: Bool[ndarray, "T"]
    T_cam_obj: Float[ndarray, "T 4 4"]
    T_cam_hands: dict[Side, Float[ndarray, "T 4 4"]]
    kind: list[FrameKind]
    grasps: dict[int, GraspTrack] = field(default_factory=dict)

    @staticmethod
    def of(clip: Clip, shown: Bool[ndarray, "T"]) -> TimelineMotion:
        """Make a motion of which nothing is known yet."""
        assert clip.world is not None
        T = len(clip)
        hands = {clip.side: clip.hand.T_cam_hand.copy()}
        if clip.other_hand is not None:
            hands[clip.other_side] = clip.other_hand.track.T_cam_hand.copy()
        unknown: list[FrameKind] = ["interpolated"] * T
        where = clip.side, clip.mesh.centre, clip.world.T_world_cam, shown
        return TimelineMotion(*where, np.full((T, 4, 4), np.nan), hands, unknown)

    @property
    def T_cam_hand(self) -> Float[ndarray, "T 4 4"]:
        """Poses of the clip's own hand."""
        return self.T_cam_hands[self.side]

    @property
    def T_cam_other_hand(self) -> Float[ndarray, "T 4 4"] | None:
        """Poses of the other hand; None where it is not known."""
        return next((T for side, T in self.T_cam_hands.items() if side != self.side), None)

    def put(self, rows: Int[ndarray, "n"], found: Hypotheses, kind: FrameKind) -> None:
        """Put the first hypothesis into some frames; of ``kind`` where the object is visible."""
        self.T_cam_obj[rows] = se3.inverse(self.T_world_cam[rows]) @ found.T_world_obj(self.centre)[0]
        for row in rows[self.shown[rows]]:
            self.kind[row] = kind

    def put_grasp(self, found: GraspTrack) -> None:
        """Put a grasp into its frames, with its hand."""
        grasp, track = found.solutions.grasp, found.track
        self.T_cam_obj[grasp.rows] = track.T_cam_hand @ track.T_hand_obj[0]
        self.T_cam_hands[grasp.clip.side][grasp.rows] = track.T_cam_hand
        for row, kind in zip(grasp.rows, track.kind, strict=True):
            self.kind[row] = kind
        self.grasps[grasp.segment.first] = found

    def places(self, rows: Int[ndarray, "n"]) -> Float[ndarray, "n 3"]:
        """Return the positions of the mesh's centre before the camera, in some frames [m]."""
        return np.asarray(se3.transform(self.T_cam_obj[rows], self.centre[None])[:, 0])

    def at(self, row: int) -> Hypotheses:
        """Return the pose of one frame, in the world."""
        return Hypotheses.of_pose(self.T_world_cam[row] @ self.T_cam_obj[row], self.centre)


def split_at_gaps(segment: Segment, rows: Int[ndarray, "n"]) -> list[Segment]:
    """Split a segment into the parts that have no gaps: some of its frames, which rise."""
    parts = np.split(rows, np.flatnonzero(np.diff(rows) != 1) + 1)
    return [replace(segment, first=int(part[0]), last=int(part[-1])) for part in parts]

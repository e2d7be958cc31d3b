"""An object's motion over a timeline, as it is filled in."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.clip import Segment
from getagrip.clip.timeline import Side
from getagrip.result import FrameKind
from getagrip.timelines.between import between
from getagrip.timelines.footage import Footage
from getagrip.timelines.grasp_segment import GraspTrack
from getagrip.timelines.hypotheses import Hypotheses


@dataclass
class Motion:
    """An object's motion over a clip, as it is filled in; frames that are not yet known are NaN.

    Attributes:
        footage: what it is the motion in.
        T_cam_obj: (T, 4, 4) poses of the mesh's own frame in the camera frame.
        T_cam_hands: (T, 4, 4) poses of each known hand, by its side, corrected in its grasps.
        kind: how each frame's pose was found.
        grasps: the grasps that were solved as such, by their segment's first frame.
    """

    footage: Footage
    T_cam_obj: Float[ndarray, "T 4 4"]
    T_cam_hands: dict[Side, Float[ndarray, "T 4 4"]]
    kind: list[FrameKind]
    grasps: dict[int, GraspTrack] = field(default_factory=dict)

    @staticmethod
    def of(footage: Footage) -> Motion:
        """Nothing known yet."""
        T, clip = len(footage), footage.clip
        hands = {clip.side: clip.hand.T_cam_hand.copy()}
        if clip.other_hand is not None:
            hands[clip.other_side] = clip.other_hand.track.T_cam_hand.copy()
        return Motion(footage, np.full((T, 4, 4), np.nan), hands, ["interpolated"] * T)

    @property
    def T_cam_hand(self) -> Float[ndarray, "T 4 4"]:
        """Poses of the clip's own hand."""
        return self.T_cam_hands[self.footage.clip.side]

    @property
    def T_cam_other_hand(self) -> Float[ndarray, "T 4 4"] | None:
        """Poses of the other hand; None where it is not known."""
        return self.T_cam_hands.get(self.footage.clip.other_side)

    def put(self, rows: Int[ndarray, "n"], found: Hypotheses, kind: FrameKind) -> None:
        """The first hypothesis, in some frames; of ``kind`` where the object is seen."""
        poses = found.T_world_obj(self.footage.clip.mesh.centre)[0]
        self.T_cam_obj[rows] = self.footage.T_cam_world[rows] @ poses
        for row in self.footage.observed(rows):
            self.kind[row] = kind

    def put_grasp(self, found: GraspTrack) -> None:
        """A grasp in its frames, and its hand."""
        grasp, track = found.solutions.grasp, found.track
        self.T_cam_obj[grasp.rows] = track.T_cam_hand @ track.T_hand_obj[0]
        self.T_cam_hands[grasp.clip.side][grasp.rows] = track.T_cam_hand
        for row, kind in zip(grasp.rows, track.kind, strict=True):
            self.kind[row] = kind
        self.grasps[grasp.segment.first] = found

    def at(self, row: int) -> Hypotheses:
        """The pose of one frame, in the world."""
        T_world_obj = self.footage.T_world_cam[row] @ self.T_cam_obj[row]
        return Hypotheses.of_pose(T_world_obj, self.footage.clip.mesh.centre)

    def fill(self, known: list[Segment]) -> None:
        """The frames between segments that are known, and before and after them."""
        edges = [(None, known[0]), *itertools.pairwise(known), (known[-1], None)]
        for one, other in edges:
            begin, end = 0 if one is None else one.last + 1, len(self.kind) if other is None else other.first
            if end > begin:
                before = None if one is None else self.at(one.last)
                after = None if other is None else self.at(other.first)
                rows = np.arange(begin, end)
                self.put(rows, between(self.footage, rows, before, after), "fitted")


def split_at_gaps(segment: Segment, rows: Int[ndarray, "n"]) -> list[Segment]:
    """The parts of a segment that have no gaps: some of its frames, which rise."""
    parts = np.split(rows, np.flatnonzero(np.diff(rows) != 1) + 1)
    return [replace(segment, first=int(part[0]), last=int(part[-1])) for part in parts]

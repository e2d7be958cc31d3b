"""An object's motion over a timeline, as it is filled in."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.clip.timeline import Side
from getagrip.geometry import se3
from getagrip.result import Axis, FrameKind
from getagrip.timelines.footage import Footage
from getagrip.timelines.grasp_segment import GraspTrack
from getagrip.timelines.hypotheses import Hypotheses


@dataclass
class Motion:
    """An object's motion over a clip, as it is filled in; frames that are not yet known are NaN.

    Attributes:
        T_cam_obj: (T, 4, 4) poses of the mesh's own frame in the camera frame.
        side: of the clip's own hand.
        T_cam_hands: (T, 4, 4) poses of each known hand, by its side, corrected in its grasps.
        kind: how each frame's pose was found.
        axes: axis of each grasp, by its segment's first frame.
        grasps: the grasps that were solved as such, likewise.
        energy: of the chosen chain, and of the next best.
        notes: what is to be known about it.
    """

    T_cam_obj: Float[ndarray, "T 4 4"]
    side: Side
    T_cam_hands: dict[Side, Float[ndarray, "T 4 4"]]
    kind: list[FrameKind]
    axes: dict[int, Axis] = field(default_factory=dict)
    grasps: dict[int, GraspTrack] = field(default_factory=dict)
    energy: tuple[float, float] = (0.0, float("inf"))
    notes: list[str] = field(default_factory=list)

    @staticmethod
    def of(footage: Footage) -> Motion:
        """Nothing known yet."""
        T, clip = len(footage), footage.clip
        hands = {clip.side: clip.hand.T_cam_hand.copy()}
        if clip.other_hand is not None:
            hands[clip.other_side] = clip.other_hand.track.T_cam_hand.copy()
        return Motion(np.full((T, 4, 4), np.nan), clip.side, hands, ["interpolated"] * T)

    @property
    def T_cam_hand(self) -> Float[ndarray, "T 4 4"]:
        """Poses of the clip's own hand."""
        return self.T_cam_hands[self.side]

    @property
    def T_cam_other_hand(self) -> Float[ndarray, "T 4 4"] | None:
        """Poses of the other hand; None where it is not known."""
        return next((T for side, T in self.T_cam_hands.items() if side != self.side), None)

    def put(self, footage: Footage, rows: Int[ndarray, "n"], found: Hypotheses, kind: FrameKind) -> None:
        """The first hypothesis, in some frames; of ``kind`` where the object is seen."""
        poses = found.T_world_obj(footage.clip.mesh.centre)[0]
        self.T_cam_obj[rows] = footage.T_cam_world[rows] @ poses
        for row in footage.observed(rows):
            self.kind[row] = kind

    def at(self, footage: Footage, row: int) -> Hypotheses:
        """The pose of one frame, in the world."""
        T = footage.T_world_cam[row] @ self.T_cam_obj[row]
        centre = se3.transform(T, footage.clip.mesh.centre[None])
        return Hypotheses(T[None, None, :3, :3], centre[None], np.ones(1), np.zeros(1))

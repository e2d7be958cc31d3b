"""Hands in every frame of a clip: its own, and the other one where that is known, too."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.errors import UsageError
from getagrip.io.array_data import ArrayData, as_array, check_finite, check_ids

FINGERS = ("thumb", "index", "middle", "ring", "pinky")


@dataclass(frozen=True, eq=False)
class HandTrack(ArrayData):
    """A hand in every frame (``hand.npz``).

    The hand frame is any frame that moves with the hand and has its origin there; that of ``getagrip.hands`` is the
    frame of MANO's template. Vertex ids are counted from 0.

    Attributes:
        vertices: (T, V, 3) vertices in the hand frame [m].
        faces: (F, 3) vertex ids of the corners of each face, counter-clockwise seen from outside.
        T_cam_hand: (T, 4, 4) pose of the hand, hand frame to camera frame [m].
        regions: contact regions by name, (n,) vertex ids each: the five ``FINGERS`` (the pads of the fingertips), then
            any ``palm_*``.
        joints: (T, 21, 3) joints in the hand frame [m]: wrist, then thumb, index, middle, ring and pinky, each from the
            palm to the tip; None where they are not known.
        joints_2d: (T, 21, 2) the joints as detected or clicked in the images [px]; None if unknown. They are evidence:
            they stay when the hand is moved.
        joints_2d_confidence: (T, 21) confidence of each of them, from 0 (not detected) to 1.
    """

    vertices: Float[ndarray, "T V 3"]
    faces: Int[ndarray, "F 3"]
    T_cam_hand: Float[ndarray, "T 4 4"]
    regions: dict[str, Int[ndarray, "_"]] = field(default_factory=dict)
    joints: Float[ndarray, "T 21 3"] | None = None
    joints_2d: Float[ndarray, "T 21 2"] | None = None
    joints_2d_confidence: Float[ndarray, "T 21"] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("vertices", "T_cam_hand", "joints"):
            check_finite(f"HandTrack.{name}", getattr(self, name))
        if (self.joints_2d is None) != (self.joints_2d_confidence is None):
            raise UsageError("HandTrack.joints_2d and HandTrack.joints_2d_confidence go together")
        count = self.vertices.shape[1]
        check_ids("HandTrack.faces", self.faces, count)
        regions = {}
        for name, ids in self.regions.items():
            where = f"HandTrack.regions[{name!r}]"
            regions[name] = as_array(where, ids, Int, ("n",), {})
            check_ids(where, regions[name], count)
        object.__setattr__(self, "regions", regions)
        missing = [finger for finger in FINGERS if finger not in self.regions]
        if count and missing:  # without vertices it stands for hands that are still to come
            of_mano = "getagrip.hands.mano.load('MANO_RIGHT.pkl', 'right').model.regions has MANO's"
            needed = f"vertex ids of the pad of each fingertip; {of_mano}"
            raise UsageError(f"missing {', '.join(missing)} in HandTrack.regions: {needed}")

    def scaled(self, factor: float) -> HandTrack:
        """Return the hand in another size, about the origin of its frame."""
        return replace(
            self, vertices=factor * self.vertices, joints=None if self.joints is None else factor * self.joints
        )

    def take(self, index: Int[ndarray, "n"]) -> HandTrack:
        """Return the hand in some of the frames, in the given order."""
        optional = (self.joints, self.joints_2d, self.joints_2d_confidence)
        joints, seen, confidence = (None if each is None else each[index] for each in optional)
        return replace(
            self, vertices=self.vertices[index], T_cam_hand=self.T_cam_hand[index], joints=joints, joints_2d=seen,
            joints_2d_confidence=confidence,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class OtherHand(ArrayData):
    """The hand of the other side, in those frames of a clip in which it is known (``other_hand.npz``).

    Attributes:
        track: the hand in every frame; where it is not known, as it is in the nearest frame in which it is.
        known: (T,) frames in which it is.
    """

    track: HandTrack
    known: Bool[ndarray, "T"]

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.known) != len(self.track.vertices):
            frames = len(self.track.vertices)
            raise UsageError(f"OtherHand.known must be {frames} frames, as the hand has (got {len(self.known)})")

    @staticmethod
    def at(hand: HandTrack, rows: Int[ndarray, "n"], frames: int) -> OtherHand:
        """Make a hand that is known in the frames ``rows``, at least one, of a clip of ``frames`` frames."""
        near = np.round(np.interp(np.arange(frames), rows, np.arange(len(rows)))).astype(int)
        return OtherHand(hand.take(near), np.isin(np.arange(frames), rows))

    def take(self, index: Int[ndarray, "n"]) -> OtherHand:
        """Return the hand in some of the frames, in the given order."""
        return OtherHand(self.track.take(index), self.known[index])

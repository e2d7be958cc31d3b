"""A clip: one stable grasp or a timeline, with its hands, masks, camera, object and ground truth."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, NamedTuple, Protocol, Self

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip.timeline import Segment, Side, at_frames, check_segments, opposite_side
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.warp import Warp
from getagrip.io.array_data import ArrayData, as_array, check_finite, check_ids
from getagrip.io.files import inside, shorten_value
from getagrip.io.images import PackedMask, PackedMasks, pack_masks
from getagrip.provenance import Provenance


@dataclass(frozen=True, eq=False)
class Joint(ArrayData):
    """The joint of an articulated object: one part rotates about a line, the other has the object's pose.

    Attributes:
        moves: (V,) vertices of the rotating part.
        point: (3,) a point of the line, in the object frame [m].
        direction: (3,) direction of the line, of length 1; angles count about it by the right-hand rule.
        angle: the articulation angle of the mesh [rad].
    """

    moves: Bool[ndarray, "V"]
    point: Float[ndarray, "3"]
    direction: Float[ndarray, "3"]
    angle: float = 0.0

    def at(self, vertices: Float[ndarray, "V 3"], angles: Float[ndarray, "T"]) -> Float[ndarray, "T V 3"]:
        """Return the mesh's vertices with the joint at some angles [rad], in the object frame [m]."""
        out = np.tile(vertices, (len(angles), 1, 1))
        turn = se3.rotation_about_line(self.point, self.direction, angles - self.angle)
        out[:, self.moves] = se3.transform(turn, vertices[self.moves])
        return out


@dataclass(frozen=True, eq=False)
class Truth(ArrayData):
    """The ground truth of a clip (``truth.npz``).

    Attributes:
        T_cam_obj: (T, 4, 4) true pose of the object, object frame to camera frame [m].
        scale: true factor by which the mesh is scaled before it is posed.
        T_cam_hand: (T, 4, 4) true pose of the hand, hand frame to camera frame [m]; the clip's if no other is known.
        hand_vertices: (T, V, 3) true vertices of the hand in the hand frame [m]; the clip's if no others are known.
        articulation: (T,) angle of the object's joint [rad]; None for objects without a joint.
        joint: the joint; None for objects without one, or if only the angle is known.
    """

    T_cam_obj: Float[ndarray, "T 4 4"]
    scale: float
    T_cam_hand: Float[ndarray, "T 4 4"]
    hand_vertices: Float[ndarray, "T V 3"]
    articulation: Float[ndarray, "T"] | None = None
    joint: Joint | None = None

    def object_vertices(self, vertices: Float[ndarray, "V 3"], frames: slice) -> Float[ndarray, "n V 3"]:
        """Return the true vertices in the object frame [m] in some frames: scaled, with the true angle of the joint."""
        if self.joint is None or self.articulation is None:
            return np.tile(self.scale * vertices, (len(self.T_cam_obj[frames]), 1, 1))
        return self.scale * self.joint.at(vertices, self.articulation[frames])


FINGERS = ("thumb", "index", "middle", "ring", "pinky")


@dataclass(frozen=True, eq=False)
class HandTrack(ArrayData):
    """A hand in every frame (``hand.npz``).

    The hand frame is any frame that moves with the hand and has its origin in it; ``getagrip.hands`` uses the frame of
    MANO's template. Vertex ids are counted from 0.

    Attributes:
        vertices: (T, V, 3) vertices in the hand frame [m].
        faces: (F, 3) vertex ids of the corners of each face, counter-clockwise seen from outside.
        T_cam_hand: (T, 4, 4) pose of the hand, hand frame to camera frame [m].
        regions: contact regions by name, (n,) vertex ids each: the five ``FINGERS`` (the pads of the fingertips), then
            any ``palm_*``.
        joints: (T, 21, 3) joints in the hand frame [m]: wrist, then thumb, index, middle, ring and pinky, each from the
            palm to the tip; None if unknown.
        joints_2d: (T, 21, 2) joints detected or clicked in the images [px]; None if unknown. They are evidence, and do
            not change when the hand moves.
        joints_2d_confidence: (T, 21) confidence of each joint in ``joints_2d``, from 0 (not detected) to 1.
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
        if count and missing:  # without vertices: a placeholder for hands to come
            of_mano = "getagrip.hands.mano.load('MANO_RIGHT.pkl', 'right').model.regions has MANO's"
            needed = f"vertex ids of the pad of each fingertip; {of_mano}"
            raise UsageError(f"missing {', '.join(missing)} in HandTrack.regions: {needed}")

    def scaled(self, factor: float) -> HandTrack:
        """Return the hand scaled about the origin of its frame."""
        joints = None if self.joints is None else factor * self.joints
        return replace(self, vertices=factor * self.vertices, joints=joints)

    def take(self, index: Int[ndarray, "n"]) -> HandTrack:
        """Return the hand in some frames, in the given order."""
        optional = (self.joints, self.joints_2d, self.joints_2d_confidence)
        joints, seen, confidence = (None if each is None else each[index] for each in optional)
        return replace(
            self, vertices=self.vertices[index], T_cam_hand=self.T_cam_hand[index], joints=joints, joints_2d=seen,
            joints_2d_confidence=confidence,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class OtherHand(ArrayData):
    """The hand of the other side (``other_hand.npz``).

    Attributes:
        track: the hand in every frame; in frames with an unknown hand, that of the nearest frame with a known one.
        known: (T,) frames with a known hand.
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
        """Make a hand known in the frames ``rows``, at least one, of a clip of ``frames`` frames."""
        near = np.round(np.interp(np.arange(frames), rows, np.arange(len(rows)))).astype(int)
        return OtherHand(hand.take(near), np.isin(np.arange(frames), rows))

    def take(self, index: Int[ndarray, "n"]) -> OtherHand:
        """Return the hand in some frames, in the given order."""
        return OtherHand(self.track.take(index), self.known[index])


class PerFrame(Protocol):
    """Data of the T frames of a clip."""

    def __len__(self) -> int: ...

    def take(self, index: Int[ndarray, "n"]) -> Self:
        """Return the data of some frames, in the given order."""
        ...


class FrameMasks(NamedTuple):
    """The masks of one frame; see ``Masks``."""

    object: Bool[ndarray, "H W"]
    ignore: Bool[ndarray, "H W"]
    hand: Bool[ndarray, "H W"] | None = None

    @staticmethod
    def unknown(size: tuple[int, int]) -> FrameMasks:
        """Make the masks of a frame with an unknown mask; ``size``: width and height [px]."""
        nothing = np.zeros(size[::-1], dtype=bool)
        return FrameMasks(nothing, ~nothing)


@dataclass(frozen=True, eq=False)
class Masks(ArrayData):
    """Masks of the object in every frame, at the size of the images.

    Attributes:
        object: (T, H, W) visible pixels of the object. A frame with an unknown mask has none, and all of its pixels are
            ignored.
        ignore: (T, H, W) pixels without information on the object, such as those of a hand or another occluder in front
            of it. If none is set in any frame, the default, the clip's hand is rendered as the occluder.
        hand: (T, H, W) visible pixels of the grasping hand; None if unknown. A frame without any has no information on
            the hand.
    """

    object: Bool[ndarray, "T H W"]
    ignore: Bool[ndarray, "T H W"] = None  # type: ignore[assignment]
    hand: Bool[ndarray, "T H W"] | None = None

    def __post_init__(self) -> None:
        if self.ignore is None:
            object.__setattr__(self, "ignore", np.zeros_like(self.object, dtype=bool))
        super().__post_init__()

    @staticmethod
    def of(frames: Iterable[FrameMasks]) -> Masks:
        """Stack the masks of frames; hand masks only if all frames have them."""
        objects, ignored, hands = zip(*frames, strict=True)
        known = [hand for hand in hands if hand is not None]
        return Masks(np.stack(objects), np.stack(ignored), np.stack(known) if len(known) == len(hands) else None)

    @staticmethod
    def packed(frames: Iterable[FrameMasks], size: tuple[int, int]) -> Masks:
        """Stack masks in little memory (``PackedMasks``), read-only. ``size``: width and height [px]."""
        packed = [[None if mask is None else PackedMask.of(mask) for mask in frame] for frame in frames]
        objects, ignored, hands = (
            PackedMasks([mask for mask in column if mask is not None], (size[1], size[0])).as_array()
            for column in zip(*packed, strict=True)
        )
        return Masks(objects, ignored, hands if len(hands) == len(objects) else None)

    @property
    def in_bits(self) -> Masks:
        """The masks in little memory (``PackedMasks``), read-only."""
        hand = None if self.hand is None else pack_masks(self.hand).as_array()
        return Masks(pack_masks(self.object).as_array(), pack_masks(self.ignore).as_array(), hand)

    @property
    def observed(self) -> Bool[ndarray, "T"]:
        """True for frames with a pixel of the object that is not ignored."""
        return np.array([shown.exceeds(ignored) for shown, ignored in self._each], dtype=bool)

    @property
    def known(self) -> Bool[ndarray, "T"]:
        """True for frames with a known mask: an object's pixel, or one that is not ignored."""
        return np.array([shown.area > 0 or not ignored.is_full for shown, ignored in self._each], dtype=bool)

    @property
    def say_what_hides(self) -> bool:
        """True if pixels are ignored in a frame with a known mask."""
        return any(ignored.area > 0 and (shown.area > 0 or not ignored.is_full) for shown, ignored in self._each)

    @property
    def _each(self) -> Iterator[tuple[PackedMask, PackedMask]]:
        return zip(pack_masks(self.object).frames, pack_masks(self.ignore).frames, strict=True)

    def __len__(self) -> int:
        return len(self.object)

    def take(self, index: Int[ndarray, "n"]) -> Masks:
        """Return the masks of some frames, in the given order."""
        return Masks(self.object[index], self.ignore[index], None if self.hand is None else self.hand[index])


@dataclass(frozen=True, eq=False)
class World(ArrayData):
    """The camera's trajectory in a static world frame.

    Attributes:
        T_world_cam: (T, 4, 4) pose of the camera, camera frame to world frame [m].
        up: (3,) direction away from the ground in the world frame, of length 1; None if unknown.
        support: height along ``up`` of the plane on which the object lies in static segments [m]; None if unknown.
    """

    T_world_cam: Float[ndarray, "T 4 4"]
    up: Float[ndarray, "3"] | None = None
    support: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.support is not None and self.up is None:
            raise UsageError("World.support cannot be used without World.up, along which it is")

    def take(self, index: Int[ndarray, "n"]) -> World:
        """Return the trajectory at some frames, in the given order."""
        return replace(self, T_world_cam=self.T_world_cam[index])


@dataclass(frozen=True, eq=False, kw_only=True)
class Clip(ArrayData):
    """One stable grasp, or a timeline of segments: a hand in every frame, the object's mesh and the camera.

    Masks and other evidence are read separately (``read_masks``, ``with_evidence``).

    Attributes:
        hand: the hand in each of the T frames.
        mesh: the object's mesh, in its own frame [m].
        K: (T, 3, 3) pinhole intrinsics of each frame [px]; pixel (row i, column j) has its centre at
            (u, v) = (j + 0.5, i + 0.5).
        size: width and height of the images [px].
        side: ``left`` or ``right`` hand.
        scale: ``known`` if the mesh has the object's true size, ``free`` if the size is to be estimated.
        frames: names of the T frames, and of their mask and image files; by default numbers from 000000 on.
        name: name of the clip; results are written to a folder of this name.
        category: category of the object, such as "mug".
        handle: (P, 3) points along the middle line of the mesh's handle, in its frame [m]; none if it has no handle;
            None where it is looked for.
        fps: frames per second of the footage, for durations.
        times: (T,) time of each frame [s], rising; None if the frames follow each other at ``fps`` (``time``).
        world: poses of the camera in the world; None if unknown.
        segments: the states of a timeline (static, grasp, ...), in order; empty for one stable grasp.
        other_hand: for a timeline, the hand of the other side, which may hold the object as well; None if unknown.
        truth: the ground truth; None if unknown.
        folder: folder of the clip, with its masks and images; None for a clip that is only in memory.
        provenance: source of the data, by topic. Results repeat the assumptions.
        evidence: data of modalities in memory, by the modality's name. A modality that is not named is read from the
            folder when needed; one that is None is not used, even if the folder has its files.
        size_sigmas: within a fit with an object of stated size that is free relative to a hand, standard deviations of
            the logarithms of the hand's size and of the object's (``fitting.hand.joint_hand_object``).
        hand_scale: factor by which the hand was scaled within a fit, to match a sensor's depth.
        left_out: names of removed frames, with an invisible object or an unknown mask (``observed_frames``).
    """

    hand: HandTrack
    mesh: Mesh
    K: Float[ndarray, "T 3 3"]
    size: tuple[int, int]
    side: Side
    scale: Literal["known", "free"] = "known"
    frames: tuple[str, ...] = ()
    name: str = "clip"
    category: str = "object"
    handle: Float[ndarray, "P 3"] | None = None
    fps: float = 30.0
    times: Float[ndarray, "T"] | None = None
    world: World | None = None
    segments: tuple[Segment, ...] = ()
    other_hand: OtherHand | None = None
    truth: Truth | None = None
    folder: Path | None = None
    provenance: Provenance = field(default_factory=dict)
    evidence: Mapping[str, PerFrame | None] = field(default_factory=dict)
    size_sigmas: tuple[float, float] | None = None
    hand_scale: float = 1.0
    left_out: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("K", "times", "handle"):
            check_finite(f"Clip.{name}", getattr(self, name))
        count = len(self.hand.vertices)
        if not self.frames:
            object.__setattr__(self, "frames", tuple(f"{n:06d}" for n in range(count)))
        counts = {"frames": len(self.frames), "K": len(self.K)}
        if self.truth is not None:
            counts["truth"] = len(self.truth.T_cam_obj)
        if self.world is not None:
            counts["world"] = len(self.world.T_world_cam)
        if self.other_hand is not None:
            counts["other_hand"] = len(self.other_hand.known)
        counts |= {f"evidence[{name!r}]": len(data) for name, data in self.evidence.items() if data is not None}
        for name, value in counts.items():
            if value != count:
                raise UsageError(f"Clip.{name} must be {count} frames, as many as the hand has (got {value})")
        if self.side not in ("left", "right"):
            raise UsageError(f"Clip.side must be 'left' or 'right' (got {self.side!r})")
        if self.scale not in ("known", "free"):
            raise UsageError(f"Clip.scale must be 'known' or 'free' (got {self.scale!r})")
        check_segments(self.segments, count, self.world is not None)

    @property
    def size_beside_hand(self) -> bool:
        """True within a fit in which the sizes of both hand and object may differ from the assumed and stated ones."""
        return self.size_sigmas is not None and self.size_sigmas[0] > 0.0

    @property
    def hand_size_share(self) -> float:
        """Share of the hand in a disagreement with the object's size, by the variances; 0 outside of such a fit."""
        of_hand, of_object = (sigma**2 for sigma in self.size_sigmas or (0.0, 1.0))
        return of_hand / (of_hand + of_object)

    @property
    def time(self) -> Float[ndarray, "T"]:
        """Time of each frame [s]: ``times``, or from 0 at ``fps``, by the frames' names if they are rising numbers."""
        if self.times is not None:
            return self.times
        numbers = np.arange(len(self))
        if all(name.isascii() and name.isdigit() and len(name) < 16 for name in self.frames):
            named = np.array([int(name) for name in self.frames])
            numbers = named - named[0] if np.all(np.diff(named) > 0) else numbers
        return np.asarray(numbers / self.fps)

    @property
    def origin(self) -> Path:
        """The clip in errors: its folder or, without one, its name."""
        return self.folder or Path(self.name)

    def __len__(self) -> int:
        return len(self.frames)

    def image_file(self, n: int) -> Path | None:
        """Return the image file of a frame; None without one. Raises ``InputError`` for a link that leads out."""
        name = None if self.folder is None else find_image(self.folder, self.frames[n])
        return None if self.folder is None or name is None else inside(self.folder, name, "", "an image")

    def index_of(self, frames: Sequence[str]) -> Int[ndarray, "n"]:
        """Return the indices of frames by name. Raises ``InputError`` for an unknown name."""
        place = {name: n for n, name in enumerate(self.frames)}
        unknown = next((name for name in frames if name not in place), None)
        if unknown is not None:
            known = f"frames of the clip, {self.frames[0]} to {self.frames[-1]}"
            raise InputError(self.origin, "frames", f"the frame {shorten_value(unknown)}", known)
        return np.array([place[name] for name in frames], dtype=np.int64)

    def with_hand_at(
        self,
        T_cam_hand: Float[ndarray, "T 4 4"] | None,
        T_cam_other: Float[ndarray, "T 4 4"] | None = None,
        scale: float = 1.0,
    ) -> Clip:
        """Return the clip with its hands at other poses, such as a result's; None keeps a hand's pose.

        ``scale`` is a factor on the size of the clip's own hand, about the origin of its frame.
        """
        hand, other = self.hand if scale == 1.0 else self.hand.scaled(scale), self.other_hand
        if T_cam_hand is not None:
            hand = replace(hand, T_cam_hand=T_cam_hand)
        if T_cam_other is not None and other is not None:
            other = replace(other, track=replace(other.track, T_cam_hand=T_cam_other))
        return self if hand is self.hand and other is self.other_hand else replace(self, hand=hand, other_hand=other)

    @property
    def other_side(self) -> Side:
        """The side opposite to the clip's own hand."""
        return opposite_side(self.side)

    def with_side(self, side: Side | None) -> Clip | None:
        """Return the clip with the hand of a side as its own; None if that hand is unknown.

        With the other side's hand it has no ground truth, and some frames may lack the hand (``hand_known``).
        """
        if side == self.side:
            return self
        if side is None or self.other_hand is None:
            return None
        other = OtherHand(self.hand, np.ones(len(self), dtype=bool))
        return replace(self, hand=self.other_hand.track, side=side, other_hand=other, truth=None)

    def hand_known(self, side: Side | None) -> Bool[ndarray, "T"]:
        """Return True for frames with a known hand of a side."""
        if side == self.side:
            return np.ones(len(self), dtype=bool)
        return np.zeros(len(self), dtype=bool) if side is None or self.other_hand is None else self.other_hand.known

    def light(self) -> Clip:
        """Return the clip with a mesh of limited size (``Mesh.light``)."""
        return self if self.mesh.light is self.mesh else replace(self, mesh=self.mesh.light)

    def warped(self, warp: Warp | None) -> Clip:
        """Return the clip with its mesh deformed by a warp, if any."""
        if warp is None:
            return self
        return replace(self, mesh=warp(self.mesh), handle=None if self.handle is None else warp.moved(self.handle))

    def resized(self, factor: float) -> Clip:
        """Return the clip with its mesh scaled by a factor, without colours."""
        mesh = Mesh(factor * self.mesh.vertices, self.mesh.faces)
        return replace(self, mesh=mesh, handle=None if self.handle is None else factor * self.handle)

    def take(self, index: Int[ndarray, "n"]) -> Clip:
        """Return the clip at some frames, in the given order."""
        truth = self.truth and replace(
            self.truth,
            T_cam_obj=self.truth.T_cam_obj[index],
            T_cam_hand=self.truth.T_cam_hand[index],
            hand_vertices=self.truth.hand_vertices[index],
            articulation=None if self.truth.articulation is None else self.truth.articulation[index],
        )
        frames = tuple(self.frames[i] for i in index)
        world = self.world and self.world.take(index)
        segments = at_frames(self.segments, index)
        evidence = {name: None if data is None else data.take(index) for name, data in self.evidence.items()}
        return replace(
            self, frames=frames, K=self.K[index], hand=self.hand.take(index), truth=truth, times=self.time[index],
            world=world, segments=segments, other_hand=self.other_hand and self.other_hand.take(index),
            evidence=evidence,
        )  # fmt: skip


def find_image(folder: Path, frame: str) -> str | None:
    """Return the name of a frame's image in a clip's folder; None without one."""
    names = (f"frames/{frame}{suffix}" for suffix in (".jpg", ".png"))
    return next((name for name in names if (folder / name).is_file()), None)


def frame_indices(frames: int, wanted: int) -> Int[ndarray, "n"]:
    """Return the indices of ``wanted`` evenly spread frames, both ends included; all if there are fewer."""
    return np.unique(np.round(np.linspace(0, frames - 1, min(wanted, frames))).astype(int))

"""The scene to export: a result with its clip, as poses in time; and what several formats derive from it.

Bones: a hand as 20 rigid bodies between its 21 joints. The stage: a static frame in metres, z up, for simulators and
robots; joints, the palm and positions with quaternions in it. Text: names and numbers for files.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from scipy.spatial.transform import Rotation, Slerp

from getagrip.clip import FINGERS, Clip, OtherHand, World
from getagrip.clip.views import clip_in_view, find_cameras
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files.colours import light_of
from getagrip.io import files
from getagrip.io.terminal import print_note
from getagrip.result import FrameKind, Reconstruction
from getagrip.result.findings import Verdict

OBJECT_COLOUR, HAND_COLOUR = (0.47, 0.60, 0.68), (0.86, 0.68, 0.58)
RESERVED_VIEW_NAMES = ("camera", "stage", "hand", "other_hand", "object", "obj")
"""Names of other frames in the exports, which a view may not have."""
EVEN_STEP_TOLERANCE = 0.5
"""Largest deviation from even times at which frames count as evenly spaced [steps]."""
CAMERA_AXES_NOTE = "camera frame of each image: x right, y down, z forward; X_cam = T_cam_obj @ X_obj; metres"


def linear_colours(mesh: Mesh) -> Float[ndarray, "V 3"] | None:
    """Return the colours of a mesh's vertices as intensities of light, 0 to 1; None without any."""
    return None if mesh.colours is None else light_of(mesh.colours)


class ExportedHand(NamedTuple):
    """A hand in T frames; arrays as in ``Scene``."""

    name: str
    """Name of the hand's node, arrays and files."""
    T_cam_hand: Float[ndarray, "T 4 4"]
    vertices: Float[ndarray, "T V 3"]
    faces: Int[ndarray, "F 3"]
    joints: Float[ndarray, "T 21 3"] | None
    known: Bool[ndarray, "T"]
    """Frames in which the hand is known; in others it has the pose of the nearest known frame."""

    @property
    def in_camera(self) -> Float[ndarray, "T V 3"]:
        """Vertices in the camera frame [m]."""
        return se3.transform(self.T_cam_hand, self.vertices)

    @property
    def joints_in_camera(self) -> Float[ndarray, "T 21 3"] | None:
        """Joints in the camera frame [m]; None where unknown."""
        return None if self.joints is None else se3.transform(self.T_cam_hand, self.joints)


class ExportedView(NamedTuple):
    """A further camera in T frames; in frames that its view lacks it is that of the nearest one."""

    name: str
    """Name of its files, frame and topics."""
    T_cam_view: Float[ndarray, "T 4 4"]
    """Pose in the frame of the clip's own camera [m]."""
    K: Float[ndarray, "T 3 3"]
    size: tuple[int, int]
    """Width and height of its images [px]."""
    image_files: tuple[Path | None, ...]
    """Files of its images; None for a frame without."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Hand and object in T frames, in metres and in the camera frame of each image (x right, y down, z forward).

    Attributes:
        name: name of the clip.
        method: name of the method.
        side: side of the hand.
        category: category of the object.
        frames: (T,) names of the frames.
        time: (T,) the frames' times in the clip [s].
        fps: frames per second of the clip.
        T_cam_hand: (T, 4, 4) pose of the hand, hand frame to camera frame.
        T_hand_obj: (T, 4, 4) pose of the object, object frame to hand frame.
        object: the mesh at its estimated size, in the object frame [m], with its own colours where it has them.
        scale: scale of the clip's mesh.
        hand_vertices: (T, V, 3) the hand's vertices in the hand frame [m].
        hand_faces: (F, 3) vertex ids.
        joints: (T, 21, 3) the hand's joints in the hand frame [m], as in ``HandTrack``; None where unknown.
        K: (T, 3, 3) intrinsics [px].
        size: width and height of the images [px].
        iou: (T,) mask IOU of each frame; NaN for a mask without a pixel of the object.
        frame_kind: (T,) kind of each frame: sampled, fitted or interpolated.
        angle: (T,) angle about the latent axis [rad]; None for methods without one.
        notes: the result's notes, guesses among them.
        world: poses of the camera; None for a clip without them.
        bop: BOP's names of the clip's ``dataset``, ``split`` and ``camera``, from the clip's provenance; empty for a
            clip of no BOP dataset.
        image_files: (T,) files of the images; None for a frame without an image.
        other_hand: of a timeline, the hand of the other side, with the frames in which it is known.
        probability: calibrated probability that the poses are right relative to the hand; None without calibration.
        verdict: judgement of the result in a word: right, uncertain or wrong.
        findings_serious: number of serious findings; with any the result is probably worthless.
        views: the further cameras.
        distance_interval: interval with 90 % of the object's distance from the camera, median over frames [m]; None if
            unknown.
    """

    name: str
    method: str
    side: str
    category: str
    frames: tuple[str, ...]
    time: Float[ndarray, "T"]
    fps: float
    T_cam_hand: Float[ndarray, "T 4 4"]
    T_hand_obj: Float[ndarray, "T 4 4"]
    object: Mesh
    scale: float
    hand_vertices: Float[ndarray, "T V 3"]
    hand_faces: Int[ndarray, "F 3"]
    joints: Float[ndarray, "T 21 3"] | None
    K: Float[ndarray, "T 3 3"]
    size: tuple[int, int]
    iou: Float[ndarray, "T"]
    frame_kind: tuple[FrameKind, ...]
    angle: Float[ndarray, "T"] | None
    notes: tuple[str, ...]
    world: World | None = None
    bop: Mapping[str, str] = field(default_factory=dict)
    image_files: tuple[Path | None, ...] = ()
    other_hand: OtherHand | None = None
    probability: float | None = None
    verdict: Verdict = "uncertain"
    findings_serious: int = 0
    distance_interval: tuple[float, float] | None = None
    views: tuple[ExportedView, ...] = ()

    @staticmethod
    def of(result: Reconstruction, clip: Clip) -> Scene:
        """Make the scene of a result and its clip. Raises ``InputError`` for frames that the clip lacks."""
        index = clip.index_of(result.frames)
        warped = clip.take(index).warped(result.warp)
        some = warped.with_hand_at(result.T_cam_hand, result.T_cam_other_hand, result.hand_scale)
        away, bop = result.distance_interval_mm, _provenance_file_names(clip.provenance.get("bop"))
        views = [view.take(index) for view in find_cameras(clip)]
        seen = [clip_in_view(some, view) for view in views]
        names = _unique_names([view.name for view in views], {*RESERVED_VIEW_NAMES, *bop.values()})
        return Scene(
            name=clip.name,
            method=result.method,
            side=clip.side,
            category=clip.category,
            frames=result.frames,
            time=some.time,
            fps=clip.fps,
            T_cam_hand=some.hand.T_cam_hand,
            T_hand_obj=result.T_hand_obj,
            object=Mesh(result.scale * some.mesh.vertices, some.mesh.faces, some.mesh.colours),
            scale=result.scale,
            hand_vertices=some.hand.vertices,
            hand_faces=some.hand.faces,
            joints=some.hand.joints,
            K=some.K,
            size=clip.size,
            iou=result.iou,
            frame_kind=result.frame_kind,
            angle=None if result.axis is None else result.axis.angle,
            notes=result.notes,
            world=some.world,
            bop=bop,
            image_files=tuple(some.image_file(n) for n in range(len(some))),
            other_hand=some.other_hand,
            probability=None if result.probability_right is None else result.probability_right.value,
            verdict=result.verdict,
            findings_serious=sum(finding.serious for finding in result.findings),
            distance_interval=None if away is None else (away[0] / 1e3, away[1] / 1e3),
            views=tuple(
                ExportedView(name, view.T_cam_view, view.K, view.size, tuple(map(by.image_file, range(len(by)))))
                for name, view, by in zip(names, views, seen, strict=True)
            ),
        )

    def even(self, fps: float) -> Scene:
        """Return the scene at evenly spaced times, with a printed note; itself if its frames are near such times.

        Poses are interpolated; images and other fields are the nearest frame's.
        """
        if len(self.frames) < 2:
            return self
        time, count = self.time, round(float(self.time[-1] - self.time[0]) * fps) + 1
        wanted = np.minimum(time[0] + np.arange(count) / fps, time[-1])
        off = np.abs(time - time[0] - np.arange(len(time)) / fps).max()
        if off <= EVEN_STEP_TOLERANCE / fps:
            return self
        near = np.abs(time - wanted[:, None]).argmin(axis=1)
        between = np.abs(time[near] - wanted) > EVEN_STEP_TOLERANCE / fps / 5.0
        uneven = f"frames are up to {1e3 * off:.0f} ms off {fps:g} a second"
        print_note(f"{self.name}: {uneven}: resampled to {count} even ones")

        def vectors(values: Float[ndarray, "T ..."]) -> Float[ndarray, "n ..."]:
            flat = values.reshape(len(values), -1)
            columns = [np.interp(wanted, time, flat[:, k]) for k in range(flat.shape[1])]
            return np.stack(columns, axis=1).reshape(count, *values.shape[1:])

        def poses(T: Float[ndarray, "T 4 4"]) -> Float[ndarray, "n 4 4"]:
            turned = Slerp(time, Rotation.from_matrix(T[:, :3, :3]))(wanted).as_matrix()
            return se3.rigid(turned, vectors(T[:, :3, 3]))

        kinds: list[FrameKind] = [self.frame_kind[n] for n in near]
        for k in np.flatnonzero(between):
            kinds[k] = "interpolated"
        other = self.other_hand
        return replace(
            self, frames=tuple(self.frames[n] for n in near), time=wanted, fps=fps, T_cam_hand=poses(self.T_cam_hand),
            T_hand_obj=poses(self.T_hand_obj), hand_vertices=vectors(self.hand_vertices),
            joints=None if self.joints is None else vectors(self.joints), K=vectors(self.K), iou=self.iou[near],
            frame_kind=tuple(kinds), angle=None if self.angle is None else vectors(self.angle),
            world=None if self.world is None else replace(self.world, T_world_cam=poses(self.world.T_world_cam)),
            image_files=tuple(self.image_files[n] for n in near) if self.image_files else (),
            other_hand=None if other is None else other.take(near),
            views=tuple(
                view._replace(
                    T_cam_view=poses(view.T_cam_view), K=vectors(view.K),
                    image_files=tuple(view.image_files[n] for n in near),
                )
                for view in self.views
            ),
        )  # fmt: skip

    def in_view(self, view: ExportedView) -> Scene:
        """Return the scene in the frame of a further camera, with its images; IOU are those of the clip's own masks."""
        T, other = se3.inverse(view.T_cam_view), self.other_hand
        if other is not None:
            other = OtherHand(replace(other.track, T_cam_hand=T @ other.track.T_cam_hand), other.known)
        world = self.world and replace(self.world, T_world_cam=self.world.T_world_cam @ view.T_cam_view)
        return replace(
            self, T_cam_hand=T @ self.T_cam_hand, other_hand=other, world=world, K=view.K, size=view.size,
            image_files=view.image_files, views=(),
        )  # fmt: skip

    @property
    def T_cam_obj(self) -> Float[ndarray, "T 4 4"]:
        """(T, 4, 4) pose of the object, object frame to camera frame."""
        return np.asarray(self.T_cam_hand @ self.T_hand_obj)

    @property
    def T_world_obj(self) -> Float[ndarray, "T 4 4"] | None:
        """(T, 4, 4) pose of the object, object frame to world frame; None where the world is unknown."""
        return None if self.world is None else np.asarray(self.world.T_world_cam @ self.T_cam_obj)

    @property
    def hand(self) -> ExportedHand:
        """The clip's own hand."""
        everywhere = np.ones(len(self.frames), dtype=bool)
        return ExportedHand("hand", self.T_cam_hand, self.hand_vertices, self.hand_faces, self.joints, everywhere)

    @property
    def hands(self) -> list[ExportedHand]:
        """The clip's own hand and, if any, that of the other side."""
        if self.other_hand is None:
            return [self.hand]
        of = self.other_hand.track
        other = ExportedHand("other_hand", of.T_cam_hand, of.vertices, of.faces, of.joints, self.other_hand.known)
        return [self.hand, other]

    @property
    def cameras(self) -> list[ExportedView]:
        """The clip's own camera, as ``camera``, and the further ones."""
        T, files_of_images = (
            np.tile(np.eye(4), (len(self.frames), 1, 1)),
            self.image_files or (None,) * len(self.frames),
        )
        return [ExportedView("camera", T, self.K, self.size, files_of_images), *self.views]

    @property
    def joints_in_camera(self) -> Float[ndarray, "T 21 3"] | None:
        """The hand's joints in the camera frame [m]; None where unknown."""
        return self.hand.joints_in_camera

    @property
    def poses(self) -> dict[str, Float[ndarray, "T 4 4"]]:
        """All known poses, by name."""
        found = {"T_cam_obj": self.T_cam_obj, "T_hand_obj": self.T_hand_obj, "T_cam_hand": self.T_cam_hand}
        if self.world is not None:
            found["T_world_cam"] = self.world.T_world_cam
            found["T_world_obj"] = np.asarray(self.T_world_obj)
            found["T_world_hand"] = np.asarray(self.world.T_world_cam @ self.T_cam_hand)
        return found

    @property
    def hand_in_camera(self) -> Float[ndarray, "T V 3"]:
        """The hand's vertices in the camera frame [m]."""
        return self.hand.in_camera

    def about(self, written: dict[str, str]) -> files.Json:
        """Return the content of ``about.json``, which accompanies the files ``written`` of any format."""
        other = None
        if self.other_hand is not None:
            hand = self.hands[1]
            other = {"known": hand.known, "T_cam_hand": hand.T_cam_hand, "joints_cam": hand.joints_in_camera}
        views = {view.name: {"size": view.size, "K": view.K, "T_cam_view": view.T_cam_view} for view in self.views}
        return {
            "clip": self.name,
            "method": self.method,
            "side": self.side,
            "category": self.category,
            "object_scale": self.scale,
            "fps": self.fps,
            "frames": list(self.frames),
            "time_s": self.time,
            "frame_kind": list(self.frame_kind),
            "files": written,
            "verdict": self.verdict,
            "probability_right": self.probability,
            "findings_serious": self.findings_serious,
            "notes": list(self.notes),
            "axes": "camera frame: x right, y down, z forward; metres; T_a_b brings points of frame b to frame a",
            "world_up": None if self.world is None else self.world.up,
            "poses": self.poses,
            "joints_cam": self.joints_in_camera,
            "other_hand": other,
            **({"views": views} if views else {}),
        }


def safe_file_name(text: str) -> str:
    """Convert text to letters, digits, points and hyphens, for file names and identifiers of any program."""
    return re.sub(r"[^A-Za-z0-9.-]+", "-", text).strip("-.")[:80] or "clip"


def _unique_names(names: Iterable[str], taken: set[str]) -> list[str]:
    """Return file names of views, each once, and none that is taken."""
    found = list[str]()
    for safe in map(safe_file_name, names):
        found.append(next(name for k in count() if (name := safe + "-view" * k) not in {*taken, *found}))
    return found


def frame_file_names(frames: Sequence[str]) -> list[str]:
    """Return file names of the frames: the frames' names if all are portable, else their indices."""
    if all(map(files.is_portable_name, frames)):
        return list(frames)
    return [f"{n:06d}" for n in range(len(frames))]


def format_vector(values: Float[ndarray, "*n"]) -> str:
    """Write numbers with spaces between them."""
    return " ".join(f"{x:.9g}" for x in np.ravel(values))


def csv_text(rows: Iterable[Iterable[object]]) -> bytes:
    """Write rows as CSV in UTF-8."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode()


def _provenance_file_names(entry: object) -> dict[str, str]:
    """Return the texts of a provenance entry, safe for file names."""
    named = entry.items() if isinstance(entry, dict) else ()
    return {str(key): safe_file_name(value) for key, value in named if isinstance(value, str)}


HAND_JOINT_NAMES = ("wrist", *(f"{finger}_{part}" for finger in FINGERS for part in (1, 2, 3, "tip")))
"""Names of the 21 joints in this package's order: wrist, then each finger from the palm to the tip."""
BONE_END_JOINTS = tuple((0 if n % 4 == 1 else n - 1, n) for n in range(1, 21))
"""The joints at the beginning and the end of each bone."""
BONE_RADIUS_QUANTILE = 0.25
"""Quantile of the distances of a bone's vertices that is the bone's radius."""
MIN_BONE_RADIUS_M = 0.003


@dataclass(frozen=True)
class Bones:
    """The bones of a hand over T frames.

    Attributes:
        T_hand_bone: (T, 20, 4, 4) poses, bone frame to hand frame [m]: the origin at the first joint, z to the second.
        length: (20,) median lengths [m].
        radius: (20,) radii of capsules that lie within the hand [m].
    """

    T_hand_bone: Float[ndarray, "T 20 4 4"]
    length: Float[ndarray, "20"]
    radius: Float[ndarray, "20"]

    @staticmethod
    def of(scene: Scene) -> Bones | None:
        """Return the bones of the scene's hand; None for a hand without joints."""
        if scene.joints is None:
            return None
        begin, end = (scene.joints[:, [pair[k] for pair in BONE_END_JOINTS]] for k in (0, 1))
        along = end - begin
        length = np.linalg.norm(along, axis=-1)
        straight = np.where(length[..., None] > 1e-6, along / np.maximum(length, 1e-6)[..., None], [0.0, 0.0, 1.0])
        rest = se3.rotation_between(np.array([0.0, 0.0, 1.0]), straight[0])
        R = se3.rotation_between(straight[:1], straight) @ rest
        typical = np.median(length, axis=0)
        return Bones(se3.rigid(R, begin), typical, _bone_radii(bone_distances(scene)))


def bone_distances(scene: Scene) -> Float[ndarray, "V 20"]:
    """Compute the distance of each vertex from each bone in the first frame [m], for a hand with joints."""
    assert scene.joints is not None
    begin, end = (scene.joints[0, [pair[k] for pair in BONE_END_JOINTS]] for k in (0, 1))
    points, along = scene.hand_vertices[0], end - begin
    share = np.sum((points[:, None] - begin) * along, axis=-1) / np.maximum(np.sum(along**2, axis=-1), 1e-12)
    nearest = begin + np.clip(share, 0.0, 1.0)[..., None] * along
    return np.asarray(np.linalg.norm(points[:, None] - nearest, axis=-1))


def _bone_radii(distance: Float[ndarray, "V 20"]) -> Float[ndarray, "20"]:
    """Compute the distance of bones to their nearest vertices: a capsule of the palm's thickness reaches the object."""
    owner = np.argmin(distance, axis=1)
    found = [
        np.quantile(distance[owner == n, n], BONE_RADIUS_QUANTILE) if np.any(owner == n) else MIN_BONE_RADIUS_M
        for n in range(distance.shape[1])
    ]
    return np.maximum(found, MIN_BONE_RADIUS_M)


Z = np.array([0.0, 0.0, 1.0])
"""Up in the stage frame."""
WRIST_JOINT, INDEX_KNUCKLE_JOINT, MIDDLE_KNUCKLE_JOINT, RING_KNUCKLE_JOINT = 0, 5, 9, 13
FINGERTIP_JOINTS = (4, 8, 12, 16, 20)


@dataclass(frozen=True)
class StageFrame:
    """A static frame, z up.

    Attributes:
        T_stage_cam: (T, 4, 4) pose of the camera, camera frame to stage frame [m].
        words: definition of the frame, with its guesses.
    """

    T_stage_cam: Float[ndarray, "T 4 4"]
    words: str

    @staticmethod
    def of(scene: Scene) -> StageFrame:
        """Make the stage: the world frame turned z up.

        Without a world the camera is assumed to be static, without up to be level.
        """
        up = None if scene.world is None else scene.world.up
        if scene.world is None:
            T = np.tile(np.eye(4), (len(scene.frames), 1, 1))
            words = "the camera's own frame, the camera taken to stand still and to be level (a guess)"
        elif up is None:
            T = scene.world.T_world_cam
            words = "the clip's world, the camera taken to be level in the first frame (a guess)"
        else:
            T, words = scene.world.T_world_cam, "the clip's world"
        if up is None:
            up = -T[0, :3, 1]
        turn = se3.rigid(se3.rotation_between(up / np.linalg.norm(up), Z))
        return StageFrame(np.asarray(turn @ T), f"{words}, turned z up; metres")

    def poses(self, scene: Scene) -> tuple[Float[ndarray, "T 4 4"], Float[ndarray, "T 4 4"]]:
        """Return the (T, 4, 4) poses of the object and of the hand on the stage."""
        return np.asarray(self.T_stage_cam @ scene.T_cam_obj), np.asarray(self.T_stage_cam @ scene.T_cam_hand)


def joints_on_stage(scene: Scene, stage: StageFrame, to: str) -> Float[ndarray, "T 21 3"]:
    """Return the joints in the stage frame [m]. Raises ``UsageError``, for the format ``to``, without joints."""
    if scene.joints is None:
        raise UsageError(f"missing joints in hand.npz of the clip {scene.name}: --to {to} needs 21")
    return se3.transform(stage.poses(scene)[1], scene.joints)


def palm_orientation(joints: Float[ndarray, "T 21 3"], side: str, across: int) -> Float[ndarray, "T 3 3"]:
    """Return the palm's orientation: z from the wrist to the middle knuckle, y of a right hand to the index finger.

    The plane of y and z contains the direction from the knuckle ``across`` to the index knuckle. x and y of a left hand
    are reversed.
    """
    z = _normalise(joints[:, MIDDLE_KNUCKLE_JOINT] - joints[:, WRIST_JOINT])
    x = _normalise(np.cross(joints[:, INDEX_KNUCKLE_JOINT] - joints[:, across], z))
    y = np.cross(z, x)
    sign = -1.0 if side == "left" else 1.0
    return np.stack([sign * x, sign * y, z], axis=-1)


def pose7(T: Float[ndarray, "T 4 4"], last: str) -> Float[ndarray, "T 7"]:
    """Return positions [m] and quaternions: position, (w, x, y, z) or, for ``xyzw``, (x, y, z, w), position."""
    q, t = se3.quaternions_in_time(T[:, :3, :3]), T[:, :3, 3]
    return np.concatenate([t, q] if last == "wxyz" else [np.roll(q, -1, axis=1), t], axis=1)


def extra_arrays(scene: Scene) -> dict[str, ndarray]:
    """Return arrays that the formats' readers ignore: all poses, times, and names and kinds of frames."""
    return {
        **scene.poses,
        "time_s": scene.time,
        "frames": np.array(scene.frames, dtype=np.str_),
        "frame_kind": np.array(scene.frame_kind, dtype=np.str_),
    }


def _normalise(v: Float[ndarray, "T 3"]) -> Float[ndarray, "T 3"]:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12))

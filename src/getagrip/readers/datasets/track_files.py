"""Any motion capture of hands and objects, brought into one layout (docs/formats.md#tracks): no MANO is needed.

A file is one sequence of one object with one or two hands:

    <anything>.npz   joints_left, joints_right   (T, 21, 3): joints in the world [m], NaN where unknown; one or both
                     order                       text: openpose or ho3d, the order of the joints
                     T_world_obj                 (T, 4, 4): object to world [m], NaN where unknown
                     mesh                        text: name of the mesh's file, in the same folder [m]
                     fps                         frames per second
                     category, subject, sequence texts; they name the clips
    optional         estimated_left, _right      (T, 21, 3): the joints of an estimator, of the same sides: the clips'
                                                 input hands, the true hands are their ground truth
                     frames                      (T,): numbers of the frames, rising; by default from 0
                     source, licence             texts, for the provenance
                     articulation                (T,): angle of the object's joint [rad]
                     mesh_top, joint             text: the mesh of the part that turns; (2, 3): a point of the axis [m],
                                                 its direction, in the object's frame
                     K, size, T_cam_world        (3, 3), (2,) [px], (4, 4) or (T, 4, 4): the camera; all three or none
                     assumed_camera              text: a description of the camera, if it is assumed

Meshes are subdivided until contact can be counted by their vertices. Hands are the generic hand fitted to the joints,
which do not determine a surface: it is a few millimetres off, so contacts at 0 mm depend on the fit more than on the
grasp. Without a camera, z must be up in the world, and a static camera at a plausible position of the person's eyes is
assumed: all of its numbers are guesses.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float, Int, Shaped
from numpy import ndarray
from tyro.conf import arg

from getagrip.clip import HandTrack, Joint, World
from getagrip.clip.timeline import SIDES
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh, subdivide_parts
from getagrip.geometry.mesh_files import read_mesh
from getagrip.hands import generic
from getagrip.hands.fit_joints import JOINT_ORDERS, fit_joints
from getagrip.hands.model import HandModel, Side, hand_track
from getagrip.io import arrays
from getagrip.io.files import inside, is_portable_name, list_files, shorten_value
from getagrip.provenance import Provenance, Source, assumed, estimated, measured
from getagrip.readers.datasets.cutting import TrackedDataset
from getagrip.readers.datasets.dataset import Note
from getagrip.readers.datasets.tracks import SequenceSource, Track, check_length
from getagrip.stable_grasps.definition import MIN_GRASP_FRAMES, GraspOptions

ASSUMED_CAMERA_DISTANCE_M = 0.7
"""Distance of the assumed camera from the object's median position [m]: about an arm's length."""
ASSUMED_CAMERA_ELEVATION_RAD = np.radians(45.0)
"""Angle by which the assumed camera looks down [rad]."""
ASSUMED_IMAGE_SIZE_PX = (840, 600)
"""Width and height of the assumed images [px], those of this package's ARCTIC masks."""
ASSUMED_FOCAL_PX = 600.0
"""Assumed focal length [px]: a field of view of 70 by 53 degrees."""
MIDDLE_KNUCKLE = 9
"""Index of the middle finger's knuckle among the 21 joints; the wrist is joint 0."""


@dataclass(frozen=True)
class HandObjectMotion:
    """Joints of the hands, and the object, in every frame of a sequence."""

    file: Path
    """The file that was read."""
    subject: str
    sequence: str
    category: str
    fps: float
    numbers: Int[ndarray, "T"]
    """Numbers of the frames, rising."""
    joints: dict[Side, Float[ndarray, "T 21 3"]]
    """Joints of one hand or both in the world frame [m], in this package's order."""
    T_world_obj: Float[ndarray, "T 4 4"]
    mesh: Mesh
    """The object, at ``joint.angle`` if articulated."""
    provenance: Provenance
    joint: Joint | None = None
    articulation: Float[ndarray, "T"] | None = None
    """Angle of the joint [rad]."""
    camera: PosedCamera | None = None
    """None if unknown: a camera is assumed, and z is up in the world frame."""
    estimated: dict[Side, Float[ndarray, "T 21 3"]] = field(default_factory=dict)
    """The joints of an estimator, to which the clips' input hands are fitted."""


def motion_tracks(motion: HandObjectMotion) -> Iterator[Track]:
    """Yield the object in each hand. Raises ``InputError`` for impossible joints."""
    fitted = {side: fit_hand(motion.file, f"{side} joints", side, j) for side, j in motion.joints.items()}
    camera, up = motion.camera, None
    if camera is None:
        up = np.array([0.0, 0.0, 1.0])
        places = se3.transform(motion.T_world_obj, motion.mesh.centre[None])[:, 0]
        camera = assumed_camera(places, motion.joints.values())
    hands = {side: hand_to_camera(hand.track, camera.T_cam_world) for side, hand in fitted.items()}
    for side, hand in hands.items():
        described = "the generic hand, fitted to the true 21 joints over all frames: not the true surface"
        provenance = motion.provenance | {"hands": described, "hand_fit": _describe_hand_fit(fitted[side])}
        input_hand = None
        if side in motion.estimated:
            value = fit_hand(motion.file, f"estimated {side} joints", side, motion.estimated[side])
            input_hand = hand_to_camera(value.track, camera.T_cam_world)
            provenance["truth"] = f"{described}; {_describe_hand_fit(fitted[side])}"
            provenance["hands"] = estimated("the generic hand, fitted to 21 joints that were estimated")
            provenance["hand_fit"] = _describe_hand_fit(value)
        yield Track(
            file=motion.file,
            subject=motion.subject,
            sequence=motion.sequence,
            category=motion.category,
            side=side,
            fps=motion.fps,
            numbers=motion.numbers,
            digits=6,
            size=camera.size,
            K=camera.K,
            hand=hand,
            T_cam_obj=camera.T_cam_world @ motion.T_world_obj,
            mesh=motion.mesh,
            joint=motion.joint,
            articulation=motion.articulation,
            other_hand=next((other for of, other in hands.items() if of != side), None),
            world=World(se3.inverse(camera.T_cam_world), up),
            input_hand=input_hand,
            provenance=provenance | {"camera": camera.described},
        )


def _describe_hand_fit(hand: FittedHand) -> str:
    return describe_fit(hand.residuals) + ", over the sequence"


def hand_to_camera(hand: HandTrack, T_cam_world: Float[ndarray, "T 4 4"]) -> HandTrack:
    """Transform a hand from the world frame to the camera frame."""
    return replace(hand, T_cam_hand=T_cam_world @ hand.T_cam_hand)


@dataclass(frozen=True)
class PosedCamera:
    """A pinhole with its pose in each frame, and a description for the provenance."""

    K: Float[ndarray, "3 3"]
    size: tuple[int, int]
    T_cam_world: Float[ndarray, "T 4 4"]
    described: Source


def assumed_camera(places: Float[ndarray, "T 3"], hands: Iterable[Float[ndarray, "T 21 3"]]) -> PosedCamera:
    """Place a static camera on the forearms' side that looks at the object's median position.

    ``places`` are the object's positions, ``hands`` joints in this package's order, in a world frame with z up [m].
    """
    up = np.array([0.0, 0.0, 1.0])
    behind = np.concatenate([joints[:, 0] - joints[:, MIDDLE_KNUCKLE] for joints in hands]).mean(axis=0)
    behind -= (behind @ up) * up
    if np.linalg.norm(behind) < 1e-6:  # hands that point straight up or down: any side
        behind = np.array([1.0, 0.0, 0.0])
    behind /= np.linalg.norm(behind)
    z = -(np.cos(ASSUMED_CAMERA_ELEVATION_RAD) * behind + np.sin(ASSUMED_CAMERA_ELEVATION_RAD) * up)
    x = np.cross(z, up) / np.cos(ASSUMED_CAMERA_ELEVATION_RAD)
    side = f"on the forearms' side, {np.degrees(ASSUMED_CAMERA_ELEVATION_RAD):.0f} degrees above it"
    return camera_facing_object(np.stack([x, np.cross(z, x), z]), places, f"a guess: none is given; fixed, {side}")


def camera_facing_object(
    R_cam_world: Float[ndarray, "3 3"], places: Float[ndarray, "T 3"], described: str
) -> PosedCamera:
    """Place a static camera of an orientation ``ASSUMED_CAMERA_DISTANCE_M`` before an object's median position [m]."""
    t = [0.0, 0.0, ASSUMED_CAMERA_DISTANCE_M] - R_cam_world @ np.median(places, axis=0)
    T_cam_world = se3.rigid(R_cam_world, t)
    K, size = assumed_pinhole()
    described += f", {ASSUMED_CAMERA_DISTANCE_M:g} m from its median place, focal length {ASSUMED_FOCAL_PX:g} px"
    return PosedCamera(K, size, np.tile(T_cam_world, (len(places), 1, 1)), assumed(described))


def assumed_pinhole() -> tuple[Float[ndarray, "3 3"], tuple[int, int]]:
    """Return the assumed intrinsics and image size [px]."""
    f, (width, height) = ASSUMED_FOCAL_PX, ASSUMED_IMAGE_SIZE_PX
    return np.array([[f, 0.0, width / 2.0], [0.0, f, height / 2.0], [0.0, 0.0, 1.0]]), ASSUMED_IMAGE_SIZE_PX


@dataclass(frozen=True)
class FittedHand:
    """The generic hand in every frame, of one shape, in the joints' frame."""

    track: HandTrack
    residuals: Float[ndarray, "T 21"]
    """Distances of the hand's joints from the true joints [m]."""


def fit_hand(file: Path, key: str, side: Side, joints: Float[ndarray, "T 21 3"]) -> FittedHand:
    """Fit the generic hand to joints [m] in this package's order.

    Raises ``InputError`` with ``file`` and ``key`` for impossible joints.
    """
    model = generic.load(side)
    try:
        fit = fit_joints(model, joints, "openpose")
    except UsageError as error:
        raise InputError(file, key, str(error), "the 21 joints of a hand") from error
    posed = model.with_shape(_normalise_girth(model, fit.shape, joints)).with_pose(fit.pose)
    track = hand_track(posed, fit.hand.T_cam_hand)
    return FittedHand(track, np.linalg.norm(se3.transform(track.T_cam_hand, posed.joints) - joints, axis=-1))


def describe_fit(residuals: Float[ndarray, "T 21"]) -> str:
    """Describe a hand's fit by its joints' residuals [m]."""
    off = 1e3 * residuals
    rms = np.sqrt(np.mean(off**2))
    return f"joints {rms:.1f} mm off (root mean square; median {np.median(off):.1f}, worst {off.max():.1f})"


def _normalise_girth(
    model: HandModel, shape: Float[ndarray, "S"], joints: Float[ndarray, "T 21 3"]
) -> Float[ndarray, "S"]:
    """Return the shape with fingers in proportion to the hand's length: joints do not determine the girth."""
    length = np.median(_mean_finger_length(joints)) / _mean_finger_length(model.with_shape().with_pose().joints)
    shape = shape.copy()
    shape[model.shape_names.index("thickness")] = length - 1.0 - shape[model.shape_names.index("size")]
    return shape


def _mean_finger_length(joints: Float[ndarray, "*batch 21 3"]) -> Float[ndarray, "*batch"]:
    """Compute the mean length of the four fingers along the bones from the wrist to the tip [m]."""
    wrist = np.broadcast_to(joints[..., None, :1, :], (*joints.shape[:-2], 4, 1, 3))
    chains = np.concatenate([wrist, joints[..., 5:, :].reshape(*joints.shape[:-2], 4, 4, 3)], axis=-2)
    return np.asarray(np.linalg.norm(np.diff(chains, axis=-2), axis=-1).sum(axis=-1).mean(axis=-1))


TRACK_NAME_KEYS = ("category", "subject", "sequence")
CAMERA_KEYS = ("K", "size", "T_cam_world")
ARTICULATION_KEYS = ("articulation", "mesh_top", "joint")
SOURCE_TEXT_KEYS = ("source", "licence", "assumed_camera")
JOINT_ARRAY_KEYS = tuple(f"{kind}_{side}" for kind in ("joints", "estimated") for side in SIDES)
OTHER_KEYS = ("order", "T_world_obj", "mesh", "fps", "frames")
TRACK_FILE_KEYS = {
    *JOINT_ARRAY_KEYS, *OTHER_KEYS, *TRACK_NAME_KEYS, *CAMERA_KEYS, *ARTICULATION_KEYS, *SOURCE_TEXT_KEYS
}  # fmt: skip
GRASP_OPTIONS_10_MM = GraspOptions(contact_mm=10.0, shortest=MIN_GRASP_FRAMES)
"""The definition of ``arctic``, but for contact within 10 mm: there, unlike at 0 mm, fitted hands touch as true hands
do (docs/arctic.md)."""
MAX_TRACK_FPS = 1000.0

Arrays = dict[str, Shaped[ndarray, "..."]]


@dataclass(frozen=True, kw_only=True)
class Tracks(TrackedDataset):
    """Any motion capture: files of joints and object poses (docs/formats.md): every visible stable grasp."""

    grasps: Annotated[GraspOptions, arg(name="")] = GRASP_OPTIONS_10_MM
    """Definition of a stable grasp."""

    def sources(self) -> list[SequenceSource]:
        """List the file ``root``, or the files in a folder."""
        files = [self.root] if self.root.is_file() else list_files(self.root, (".npz",))
        if not files:
            raise InputError(self.root, "", "no .npz file", "a file of tracks, or a folder of them")
        return [SequenceSource(file.stem, partial(_read_tracks, file)) for file in files]


def _read_tracks(file: Path, note: Note) -> Iterator[Track]:

    motion = read_motion(file, note)
    if motion is not None:
        yield from motion_tracks(motion)


def read_motion(file: Path, note: Note) -> HandObjectMotion | None:
    """Read a file, in the frames in which all arrays are known; None, after a note, with fewer than 2 such frames.

    Raises ``InputError``.
    """
    stored = arrays.read(file, TRACK_FILE_KEYS.__contains__)
    order = _read_joint_order(file, stored)
    category, subject, sequence = (_read_name(file, stored, key) for key in TRACK_NAME_KEYS)
    poses = _read_with_unknown_frames(file, stored, "T_world_obj", (-1, 4, 4))
    T = len(poses)
    check_length(file, "T_world_obj", T)
    joints, estimated = _read_joint_arrays(file, stored, "joints", T), _read_joint_arrays(file, stored, "estimated", T)
    if not joints:
        raise InputError(file, "joints_left, joints_right", "none of them", "the joints of a hand or of both")
    if estimated and estimated.keys() != joints.keys():
        raise InputError(file, "estimated_left, estimated_right", "not those of joints_...", "the same sides, or none")
    known = np.isfinite(poses).all(axis=(1, 2))
    for of_side in (*joints.values(), *estimated.values()):
        known &= np.isfinite(of_side).all(axis=(1, 2))
    rows = np.flatnonzero(known)
    if rows.size < 2:
        note(f"{file.name}: hands and object are known in {rows.size} of {T} frames: skipped")
        return None
    if not se3.is_rigid(poses[rows]).all():
        raise InputError(file, "T_world_obj", "matrices that are not rigid", "rotations and translations [m]")
    mesh, joint = _read_object(file, stored)
    return HandObjectMotion(
        file=file,
        subject=subject,
        sequence=sequence,
        category=category,
        fps=_read_fps(file, stored),
        numbers=_read_frame_numbers(file, stored, T)[rows],
        joints={side: of_side[rows][:, order] for side, of_side in joints.items()},
        estimated={side: of_side[rows][:, order] for side, of_side in estimated.items()},
        T_world_obj=poses[rows],
        mesh=mesh,
        joint=joint,
        articulation=arrays.floats(file, stored, "articulation", (T,))[rows] if "articulation" in stored else None,
        camera=_read_posed_camera(file, stored, T, rows),
        provenance={
            "source": f"{file.name}, {subject}/{sequence}",
            **{key: _read_text(file, stored, key) for key in ("source", "licence") if key in stored},
            "scale": f"the file's mesh, taken as of true size; long edges halved: {len(mesh.vertices)} vertices",
        },
    )


def _read_joint_arrays(file: Path, arrays: Arrays, kind: str, T: int) -> dict[Side, Float[ndarray, "T 21 3"]]:
    """Read the joints of each hand in the file, in the file's order."""

    there = {side: key for side in SIDES if (key := f"{kind}_{side}") in arrays}
    return {side: _read_with_unknown_frames(file, arrays, key, (T, 21, 3)) for side, key in there.items()}


def _read_object(file: Path, value: Arrays) -> tuple[Mesh, Joint | None]:
    """Read the object from its mesh, or from two meshes if articulated."""
    has = [key for key in ARTICULATION_KEYS if key in value]
    if has and len(has) < len(ARTICULATION_KEYS):
        raise InputError(file, ", ".join(ARTICULATION_KEYS), f"only {', '.join(has)}", "all of them, or none")
    parts = []
    for key in ("mesh", "mesh_top") if has else ("mesh",):
        parts.append(read_mesh(inside(file.parent, _read_text(file, value, key), key, "a mesh", file)))
    mesh, part = subdivide_parts(parts)
    if not has:
        return mesh, None
    point, direction = arrays.floats(file, value, "joint", (2, 3))
    length = float(np.linalg.norm(direction))
    if length < 1e-6:
        raise InputError(file, "joint", "a direction of length 0", "a direction of the axis")
    return mesh, Joint(moves=part == 1, point=point, direction=direction / length)


def _read_posed_camera(file: Path, value: Arrays, T: int, rows: Int[ndarray, "n"]) -> PosedCamera | None:
    """Read the camera in some frames; None without a camera in the file."""
    has = [key for key in CAMERA_KEYS if key in value]
    if not has:
        return None
    if len(has) < len(CAMERA_KEYS):
        raise InputError(file, ", ".join(CAMERA_KEYS), f"only {', '.join(has)}", "all of them, or none")
    K = arrays.floats(file, value, "K", (3, 3))
    width, height = (float(n) for n in arrays.floats(file, value, "size", (2,), kinds="iuf"))
    if not (1 <= width <= 10_000 and 1 <= height <= 10_000 and width % 1 == height % 1 == 0):
        raise InputError(file, "size", f"{width:g} x {height:g}", "width and height in pixels, 1 to 10000")
    T_cam_world = arrays.floats(file, value, "T_cam_world", (4, 4) if value["T_cam_world"].ndim == 2 else (T, 4, 4))
    if not se3.is_rigid(T_cam_world).all():
        raise InputError(file, "T_cam_world", "matrices that are not rigid", "rotations and translations [m]")
    source = measured("the file's own")
    if "assumed_camera" in value:
        source = assumed(_read_text(file, value, "assumed_camera"))
    return PosedCamera(K, (int(width), int(height)), np.broadcast_to(T_cam_world, (T, 4, 4))[rows], source)


def _read_frame_numbers(file: Path, value: Arrays, T: int) -> Int[ndarray, "T"]:
    if "frames" not in value:
        return np.arange(T)
    numbers = arrays.floats(file, value, "frames", (T,), kinds="iu").astype(np.int64)
    if numbers[0] < 0 or np.any(np.diff(numbers) <= 0) or numbers[-1] >= 10**9:
        raise InputError(file, "frames", shorten_value(numbers[:8].tolist()), "rising numbers from 0 to 999999999")
    return numbers


def _read_fps(file: Path, value: Arrays) -> float:
    fps = float(arrays.floats(file, value, "fps", (), kinds="iuf"))
    if not 0.0 < fps <= MAX_TRACK_FPS:
        raise InputError(file, "fps", f"{fps:g}", f"frames per second, up to {MAX_TRACK_FPS:g}")
    return fps


def _read_with_unknown_frames(file: Path, value: Arrays, key: str, shape: tuple[int, ...]) -> Float[ndarray, "T ..."]:
    """Check an array in which whole frames may be NaN. Raises ``InputError``, also for frames that are partly NaN."""
    if key in value and value[key].dtype.kind == "f" and value[key].ndim == len(shape):
        values = value[key].astype(float)
        unknown = np.asarray(np.isnan(values).all(axis=tuple(range(1, len(shape)))))
        values[unknown] = 0.0
        values = arrays.floats(file, {key: values}, key, shape)
        values[unknown] = np.nan
        return values
    return arrays.floats(file, value, key, shape)


def _read_text(file: Path, arrays: Arrays, key: str) -> str:
    if key not in arrays:
        raise InputError(file, key, "no such array", "a text")
    value = arrays[key]
    if value.dtype.kind != "U" or value.ndim != 0 or not 0 < len(str(value)) <= 200 or not str(value).isprintable():
        raise InputError(file, key, f"{value.dtype} of shape {value.shape}", "a text of up to 200 printable characters")
    return str(value)


def _read_name(file: Path, arrays: Arrays, key: str) -> str:
    name = _read_text(file, arrays, key)
    if not is_portable_name(name):
        raise InputError(file, key, shorten_value(name), "a name that can be part of a folder's")
    return name


def _read_joint_order(file: Path, arrays: Arrays) -> list[int]:
    """Return the index of each of this package's joints in the file."""
    order = _read_text(file, arrays, "order")
    for name, places in JOINT_ORDERS.items():
        if order == name:
            return places
    raise InputError(file, "order", shorten_value(order), f"one of {', '.join(JOINT_ORDERS)}")

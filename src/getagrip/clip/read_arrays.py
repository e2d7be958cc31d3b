"""Read a clip's hands and ground truth, and check its arrays against plausible limits (docs/formats.md).

Errors name the most frequent cause of an implausible value.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.clip.clip import FINGERS, Clip, HandTrack, Joint, OtherHand, Truth
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import check_size
from getagrip.io import arrays, files
from getagrip.io.files import shorten_value

MIN_CAMERA_RANGE_M, MAX_CAMERA_RANGE_M = 0.05, 100.0
"""Plausible distances from the camera [m]. HaMeR's focal length puts the hands of a video at 20 to 70 m."""
MIN_FPS, MAX_FPS = 0.001, 100_000.0
MAX_CLIP_DURATION_S = 86_400.0
MAX_CAMERA_TRAVEL_M = 1000.0
"""Maximum distance of a camera from its first position [m]."""
MAX_WORLD_DISTANCE_M = 1e5
"""Maximum coordinate of a camera in the world [m]; beyond, single precision does not resolve a centimetre."""
MAX_HAND_OFFSET_M = 0.25
"""Maximum distance of a hand's centre from the origin of the hand frame, which is in the hand [m]."""
ASPECT_RATIO_TOLERANCE = 0.06
"""Maximum difference between the log aspect ratios of an image and the clip's images: networks round sides to multiples
of 14 or 32 pixels."""
EXPECTED_HAND_FILE = "the hands of a clip, as getagrip import hands writes them"
OTHER_HAND_FILE = "other_hand.npz"
"""File of the other side's hand, in a clip's folder."""
MAX_PALM_REGIONS, MAX_REGIONS_PER_VERTEX = 100, 8
"""Maximum number of palm regions, and of regions per vertex on average."""
MAX_HANDLE_POINTS = 50
"""Maximum number of points along a handle."""
TRUTH_JOINT_KEYS = ("joint_moves", "joint_point", "joint_direction", "joint_angle")
"""Arrays of ``truth.npz`` on an articulated object's joint."""
MAX_HINGE_DISTANCE_M = 2.0
"""Maximum distance of a joint from the object's origin [m]."""


def check_clip(clip: Clip) -> None:
    """Check a clip made of arrays as ``read_clip`` checks files. Raises ``InputError``."""
    path, mesh, hands = clip.origin, clip.mesh, [(clip.hand, clip.K)]
    if clip.other_hand is not None and clip.other_hand.known.any():
        known = np.flatnonzero(clip.other_hand.known)
        hands.append((clip.other_hand.track.take(known), clip.K[known]))
    if not MIN_FPS <= clip.fps <= MAX_FPS:
        raise InputError(path, "fps", f"{clip.fps:g}", f"frames per second, {MIN_FPS:g} to {MAX_FPS:g}")
    if clip.times is not None:
        check_times(path, clip.times, clip.frames)
    check_intrinsics(path, clip.K, clip.size)
    if clip.world is not None:
        check_camera_poses(path, clip.world.T_world_cam, clip.frames)
    for hand, K in hands:
        check_hand(path, hand)
        check_in_view(path, hand, K, clip.size)
    check_size(path, "mesh", float(np.ptp(mesh.vertices, axis=0).max()), "the object")
    if mesh.is_closed and mesh.volume < 0:
        raise InputError(path, "mesh", "faces that look inward", "faces counter-clockwise seen from outside")
    if clip.handle is not None:
        check_handle(path, clip.handle, mesh)


def check_handle(path: Path, handle: Float[ndarray, "P 3"], mesh: Mesh) -> None:
    """Raise ``InputError`` for points of a handle that are too many, or outside the mesh's bounding box."""
    if len(handle) > MAX_HANDLE_POINTS:
        raise InputError(path, "handle", f"{len(handle)} points", f"at most {MAX_HANDLE_POINTS}")
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    outside = np.flatnonzero(np.any((handle < low) | (handle > high), axis=1))
    if len(outside):
        got = f"the point {np.round(handle[outside[0]], 4).tolist()}"
        box = f"{np.round(low, 4).tolist()} to {np.round(high, 4).tolist()}"
        raise InputError(path, "handle", got, f"points within the mesh, {box} m in its own frame")


def check_hand(path: Path, hand: HandTrack) -> None:
    """Raise ``InputError`` for hands of absurd size, away from the origin, inside out, or not before the camera."""
    if not hand.vertices.size:
        raise InputError(path, "vertices", "a hand without vertices", "its vertices in every frame")
    extent = np.ptp(hand.vertices, axis=1).max(axis=-1)
    check_size(path, "vertices", float(extent.max()), "a hand")
    check_size(path, "vertices", float(extent.min()), "a hand")
    check_in_hand(path, "vertices", hand.vertices, "a hand")
    twice = np.any(hand.faces == np.roll(hand.faces, 1, axis=1), axis=1)
    if twice.any():
        bad = f"{np.count_nonzero(twice)} faces with a vertex twice (first: {np.argmax(twice)})"
        raise InputError(path, "faces", bad, "triangles")
    corners = (hand.vertices[0] - hand.vertices[0].mean(axis=0))[hand.faces]
    if np.sum(corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])) < 0:
        raise InputError(path, "faces", "faces that look inward", "faces counter-clockwise seen from outside")
    check_poses(path, "T_cam_hand", hand.T_cam_hand, hand.vertices.mean(axis=1), "the hand")
    if hand.joints is not None:
        check_in_hand(path, "joints", hand.joints, "joints")


def check_shape(
    path: Path, key: str, size: tuple[int, int], of_clip: tuple[int, int], stretch: float = ASPECT_RATIO_TOLERANCE
) -> None:
    """Raise ``InputError`` for an image of another aspect ratio than the clip's: cropped or turned (width, height)."""
    if min(size) < 1 or abs(math.log(size[0] / size[1] * of_clip[1] / of_clip[0])) > stretch:
        expected = f"the shape of the clip's images, {of_clip[0]} x {of_clip[1]}: neither cropped nor turned"
        raise InputError(path, key, f"{size[0]} x {size[1]} pixels", expected)


def check_intrinsics(path: Path, K: Float[ndarray, "T 3 3"], size: tuple[int, int]) -> None:
    """Raise ``InputError`` for matrices that are not a pinhole camera's without shear, or not of images of ``size``."""
    image = f"a {size[0]} x {size[1]} image"
    focal, centre = K[:, [0, 1], [0, 1]], K[:, :2, 2]
    if not np.all(focal > 0):
        raise InputError(path, "camera.K", f"the focal length {focal.min():g}", "focal lengths above 0 px")
    shear = np.abs(K[:, [0, 1], [1, 0]]).max(axis=1) > 1e-6 * focal.min()
    other = shear | np.any(K[:, 2] != [0.0, 0.0, 1.0], axis=1)
    if other.any():
        got = str(K[np.argmax(other)].tolist())
        raise InputError(path, "camera.K", got, "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]: pixels without shear")
    least, most = 0.05 * max(size), 100.0 * max(size)
    if focal.min() < least or focal.max() > most:
        odd = focal.min() if focal.min() < least else focal.max()
        raise InputError(path, "camera.K", f"the focal length {odd:g}", f"{least:g} to {most:g} px for {image}")
    off = np.any((centre < -np.array(size)) | (centre > 2 * np.array(size)), axis=1)
    if off.any():
        u, v = centre[np.argmax(off)]
        expected = f"{-size[0]} to {2 * size[0]}, {-size[1]} to {2 * size[1]} px for {image}"
        raise InputError(path, "camera.K", f"the principal point {u:g}, {v:g}", expected)


def check_times(path: Path, times: Float[ndarray, "T"], frames: Sequence[str]) -> None:
    """Raise ``InputError`` for times [s] that do not rise, or span more than ``MAX_CLIP_DURATION_S``."""
    steps = np.diff(times)
    rises = steps > 0.0
    if not rises.all():
        n = int(np.argmin(rises)) + 1
        bad = f"{times[n]:.10g} s in frame {shorten_value(frames[n])}, after {times[n - 1]:.10g} s"
        raise InputError(path, "times", bad, "numbers that rise from frame to frame")
    if len(steps) and steps.min() < 0.99 / MAX_FPS:
        n = int(np.argmin(steps)) + 1
        bad = f"frame {shorten_value(frames[n])} {steps[n - 1]:.4g} s after the one before"
        raise InputError(path, "times", bad, f"at least {1.0 / MAX_FPS:g} s; are these seconds?")
    if not times[-1] - times[0] <= MAX_CLIP_DURATION_S:
        bad = f"{times[-1] - times[0]:.4g} s from the first frame to the last"
        raise InputError(path, "times", bad, f"at most {MAX_CLIP_DURATION_S:g} s; are these nanoseconds?")


def check_camera_poses(
    path: Path, T_world_cam: Float[ndarray, "T 4 4"], frames: Sequence[str], key: str = "camera.T_world_cam"
) -> None:
    """Raise ``InputError`` for camera poses that are not rigid, or too far from the origin or the first one.

    ``key`` names them in errors.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        rigid = se3.is_rigid(T_world_cam)
        apart = np.linalg.norm(T_world_cam[:, :3, 3] - T_world_cam[0, :3, 3], axis=1)
    if not rigid.all():
        bad = f"a matrix that is no rigid motion in frame {shorten_value(frames[int(np.argmin(rigid))])}"
        raise InputError(path, key, bad, "rotations and translations [m], the last row 0 0 0 1")
    far = np.abs(T_world_cam[:, :3, 3]).max(axis=1)
    if not far.max() <= MAX_WORLD_DISTANCE_M:
        n = int(np.argmax(far))
        got = f"a camera {far[n]:.4g} m from the world's origin in frame {shorten_value(frames[n])}"
        expected = f"at most {MAX_WORLD_DISTANCE_M:g} m; subtract its first place from all, in metres"
        raise InputError(path, key, got, expected)
    if not apart.max() <= MAX_CAMERA_TRAVEL_M:
        n = int(np.argmax(apart))
        got = f"a camera {apart[n]:.4g} m from its first place in frame {shorten_value(frames[n])}"
        raise InputError(path, key, got, f"at most {MAX_CAMERA_TRAVEL_M:g} m; are these millimetres?")


def check_poses(
    path: Path, key: str, T_cam: Float[ndarray, "T 4 4"], centres: Float[ndarray, "T 3"], what: str
) -> None:
    """Raise ``InputError`` for poses that are not rigid, or with a centre behind the camera or too far away."""
    with np.errstate(over="ignore", invalid="ignore"):
        rigid = se3.is_rigid(T_cam)
        posed = se3.transform(T_cam, centres[:, None])[:, 0]
    if not rigid.all():
        bad = f"a matrix that is no rigid motion in frame {int(np.argmin(rigid))}"
        raise InputError(path, key, bad, "rotations and translations [m], the last row 0 0 0 1")
    behind, distance = posed[:, 2] <= 0, np.linalg.norm(posed, axis=1)
    if behind.any():
        n = int(np.argmax(behind))
        got = f"{what} behind the camera in frame {n} (z = {posed[n, 2]:.3g} m)"
        raise InputError(path, key, got, "z above 0, forward; is it the inverse, or of a camera that looks along -z?")
    if distance.max() > MAX_CAMERA_RANGE_M:
        n = int(np.argmax(distance))
        got = f"{what} {distance[n]:.4g} m from the camera in frame {n}"
        raise InputError(path, key, got, f"at most {MAX_CAMERA_RANGE_M:g} m; are these millimetres?")
    if distance.min() < MIN_CAMERA_RANGE_M:
        n = int(np.argmin(distance))
        got = f"{what} {distance[n]:.2g} m from the camera in frame {n}"
        raise InputError(path, key, got, f"at least {MIN_CAMERA_RANGE_M:g} m, from its own frame into the camera's")


def check_in_hand(path: Path, key: str, points: Float[ndarray, "T P 3"], what: str) -> None:
    """Raise ``InputError`` for points of a hand that are far from the origin of its frame."""
    distance = np.linalg.norm(points.mean(axis=1), axis=1)
    if distance.max() > MAX_HAND_OFFSET_M:
        n = int(np.argmax(distance))
        got = f"{what} {distance[n]:.2g} m from the origin of the hand frame in frame {n}"
        advice = "are these camera coordinates, to which T_cam_hand would apply again?"
        expected = f"at most {MAX_HAND_OFFSET_M:g} m; {advice}"
        raise InputError(path, key, got, expected)


def check_in_view(path: Path, hand: HandTrack, K: Float[ndarray, "T 3 3"], size: tuple[int, int]) -> None:
    """Raise ``InputError`` for a hand outside the image in every frame."""
    posed = se3.transform(hand.T_cam_hand, hand.vertices)
    before = posed[..., 2] > MIN_CAMERA_RANGE_M / 10.0
    uv = project(K, np.where(before[..., None], posed, [0.0, 0.0, 1.0]))
    low = np.where(before[..., None], uv, np.inf).min(axis=1)
    high = np.where(before[..., None], uv, -np.inf).max(axis=1)
    if not np.any(np.all((high > 0) & (low < size), axis=1)):
        centre = posed[:1].mean(axis=1, keepdims=True)
        u, v = project(K[:1], centre)[0, 0]
        z = centre[0, 0, 2]
        where = f"at u = {u:.0f}, v = {v:.0f} px" if z > 0 else f"{-z:.2g} m behind the camera"
        got = f"a hand outside the image in every frame (in the first {where})"
        expected = f"a hand in the {size[0]} x {size[1]} image; do T_cam_hand and clip.json's camera belong together?"
        raise InputError(path, "T_cam_hand", got, expected)


def frames_with_hand(path: Path, frames: tuple[str, ...]) -> Int[ndarray, "n"]:
    """Return the indices of the frames named in a ``hand.npz``; all without names. Raises ``InputError``.

    Numbers instead of names are ignored: in a hand file they are frame numbers of the footage.
    """
    stored = arrays.read(path, {"frames"}.__contains__).get("frames", np.arange(0))
    if stored.dtype.kind != "U":
        return np.arange(len(frames))
    expected = "names of frames of the clip, in its order, each once"
    try:
        names = [str(name) for name in stored.ravel()]
    except ValueError as error:  # invalid code points
        raise InputError(path, "frames", "a damaged text", expected) from error
    row_of = {name: row for row, name in enumerate(frames)}
    unknown = next((name for name in names if name not in row_of), None)
    if unknown is not None:
        raise InputError(path, "frames", files.shorten_value(unknown), expected)
    rows = np.array([row_of[name] for name in names], dtype=int)
    if stored.ndim != 1 or not rows.size or (np.diff(rows) <= 0).any():
        raise InputError(path, "frames", f"{files.shorten_value(' '.join(names)[:80])}", expected)
    return rows


def read_hand(path: Path, frames: int) -> HandTrack:
    """Read the hands of a ``hand.npz`` of ``frames`` frames. Raises ``InputError``."""
    named = ("vertices", "faces", "T_cam_hand", "joints", "joints_2d", "joints_2d_confidence")
    stored = arrays.read(path, lambda key: key in named or key.startswith("region_"))
    vertices = arrays.floats(path, stored, "vertices", (frames, -1, 3))
    faces = arrays.indices(path, stored, "faces", vertices.shape[1], (-1, 3))
    T_cam_hand = arrays.floats(path, stored, "T_cam_hand", (frames, 4, 4))
    joints = arrays.floats(path, stored, "joints", (frames, 21, 3)) if "joints" in stored else None
    seen = parse_joints_2d(path, stored, frames) if "joints_2d" in stored else (None, None)
    regions = _parse_contact_regions(path, stored, vertices.shape[1])
    hand = HandTrack(vertices, faces, T_cam_hand, regions, joints, *seen)
    check_hand(path, hand)
    return hand


def parse_joints_2d(
    path: Path, stored: dict[str, ndarray], frames: int
) -> tuple[Float[ndarray, "T 21 2"], Float[ndarray, "T 21"]]:
    """Parse joints in the images [px], and their confidence, by default 1."""
    points = arrays.floats(path, stored, "joints_2d", (frames, 21, 2))
    if "joints_2d_confidence" not in stored:
        return points, np.ones((frames, 21))
    confidence = arrays.floats(path, stored, "joints_2d_confidence", (frames, 21))
    if confidence.min(initial=0.0) < 0.0 or confidence.max(initial=0.0) > 1.0:
        bad = f"numbers from {confidence.min():.3g} to {confidence.max():.3g}"
        raise InputError(path, "joints_2d_confidence", bad, "0 to 1")
    return points, confidence


def _parse_contact_regions(path: Path, stored: dict[str, ndarray], count: int) -> dict[str, Int[ndarray, "_"]]:
    """Parse the contact regions of a hand, which a mesh alone does not determine."""
    missing = [f"region_{finger}" for finger in FINGERS if f"region_{finger}" not in stored]
    if missing:
        expected = f"{', '.join(missing)}: the vertex ids of each fingertip's pad"
        raise InputError(path, missing[0], f"a mesh of {count} vertices without this region", expected)
    palm = sorted(key.removeprefix("region_") for key in stored if key.startswith("region_palm_"))
    if len(palm) > MAX_PALM_REGIONS:
        raise InputError(path, "region_palm_...", f"{len(palm)} regions of the palm", f"at most {MAX_PALM_REGIONS}")
    sizes = {key: stored[f"region_{key}"].size for key in (*FINGERS, *palm)}
    if sum(sizes.values()) > MAX_REGIONS_PER_VERTEX * count:
        key, size = max(sizes.items(), key=lambda item: item[1])
        bad = f"{size} vertex ids, {sum(sizes.values())} with those of the other regions"
        raise InputError(path, f"region_{key}", bad, f"at most {MAX_REGIONS_PER_VERTEX * count} for {count} vertices")
    return {name: arrays.indices(path, stored, f"region_{name}", count, (-1,)) for name in (*FINGERS, *palm)}


def read_other_hand(
    folder: Path, frames: tuple[str, ...], rows: Int[ndarray, "n"], K: Float[ndarray, "n 3 3"], size: tuple[int, int]
) -> OtherHand | None:
    """Read the other side's hand in the clip's frames ``rows``; None without its file. Raises ``InputError``."""
    path = folder / OTHER_HAND_FILE
    if not path.exists() and not path.is_symlink():
        return None
    path = files.inside(folder, OTHER_HAND_FILE, "", EXPECTED_HAND_FILE)
    stored = frames_with_hand(path, frames)
    hand = read_hand(path, len(stored))
    _, here, found = np.intersect1d(rows, stored, return_indices=True)
    if not len(here):
        expected = "the hand in one of the frames at least in which hand.npz has the clip's own"
        raise InputError(path, "frames", f"{len(stored)} frames, and none of these", expected)
    check_in_view(path, hand.take(found), K[here], size)
    return OtherHand.at(hand.take(found), here, len(rows))


def read_truth(folder: Path, hand: HandTrack, scale: str, mesh: Mesh) -> Truth:
    """Read a clip's ``truth.npz``; the clip's own data stands for missing arrays. Raises ``InputError``."""
    path = files.inside(folder, "truth.npz", "", "the truth of a clip")
    named = ("T_cam_obj", "scale", "T_cam_hand", "hand_vertices", "articulation", *TRUTH_JOINT_KEYS)
    stored = arrays.read(path, lambda key: key in named)
    frames = len(hand.vertices)
    size = 1.0
    if "scale" in stored or scale == "free":
        size = float(arrays.floats(path, stored, "scale", (), kinds="fiu"))
    if size <= 0:
        raise InputError(path, "scale", f"{size:g}", "a number above 0")
    check_size(path, "scale", size * mesh.diameter, "the scaled object")
    vertices = hand.vertices
    if "hand_vertices" in stored:
        vertices = arrays.floats(path, stored, "hand_vertices", hand.vertices.shape)
        check_size(path, "hand_vertices", float(np.ptp(vertices, axis=1).max()), "a hand")
        check_in_hand(path, "hand_vertices", vertices, "a hand")
    T_cam_hand = hand.T_cam_hand
    if "T_cam_hand" in stored:
        T_cam_hand = arrays.floats(path, stored, "T_cam_hand", (frames, 4, 4))
        check_poses(path, "T_cam_hand", T_cam_hand, vertices.mean(axis=1), "the hand")
    T_cam_obj = arrays.floats(path, stored, "T_cam_obj", (frames, 4, 4))
    check_poses(path, "T_cam_obj", T_cam_obj, np.tile(size * mesh.centre, (frames, 1)), "the object")
    articulation = None
    if "articulation" in stored:
        articulation = arrays.floats(path, stored, "articulation", (frames,))
        if np.abs(articulation).max() > 2.0 * np.pi:
            most = f"the angle {np.abs(articulation).max():g}"
            raise InputError(path, "articulation", most, "at most a full turn [rad]; are these degrees?")
    joint = _parse_object_joint(path, stored, mesh) if any(key in stored for key in TRUTH_JOINT_KEYS) else None
    return Truth(T_cam_obj, size, T_cam_hand, vertices, articulation, joint)


def _parse_object_joint(path: Path, stored: dict[str, ndarray], mesh: Mesh) -> Joint:
    """Parse the joint of an articulated object, which also needs the articulation of each frame."""
    missing = next((key for key in ("articulation", *TRUTH_JOINT_KEYS) if key not in stored), None)
    if missing is not None:
        expected = f"all of articulation, {', '.join(TRUTH_JOINT_KEYS)}, or none of the last"
        raise InputError(path, missing, "no such array", expected)
    moves = stored["joint_moves"]
    if moves.dtype != bool or moves.shape != (len(mesh.vertices),):
        expected = f"true or false for each of the {len(mesh.vertices)} vertices of the mesh"
        raise InputError(path, "joint_moves", f"{moves.dtype} of shape {moves.shape}", expected)
    point, direction = (arrays.floats(path, stored, key, (3,)) for key in ("joint_point", "joint_direction"))
    if not np.linalg.norm(point) < MAX_HINGE_DISTANCE_M:
        got = f"a point {np.linalg.norm(point):.4g} m from the object's origin"
        raise InputError(path, "joint_point", got, f"less than {MAX_HINGE_DISTANCE_M:g} m; are these millimetres?")
    length = np.linalg.norm(direction)
    if abs(length - 1.0) > 1e-6:
        raise InputError(path, "joint_direction", f"the length {length:g}", "a direction of length 1")
    angle = float(arrays.floats(path, stored, "joint_angle", ()))
    if abs(angle) > 2.0 * np.pi:
        raise InputError(path, "joint_angle", f"{angle:g}", "at most a full turn [rad]; are these degrees?")
    return Joint(moves, point, direction, angle)

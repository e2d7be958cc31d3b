"""Limits of plausible hands and objects before a camera.

Errors name the mistake that usually leads to what they cannot be.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip.data import Clip
from getagrip.clip.hand_track import HandTrack
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.geometry.mesh_files import check_size
from getagrip.io.files import shorten_value

MIN_CAMERA_RANGE_M, MAX_CAMERA_RANGE_M = 0.05, 100.0
"""Plausible distances from the camera [m]. HaMeR's focal length puts the hands of a video at 20 to 70 m."""
MIN_FPS, MAX_FPS = 0.001, 100_000.0
"""Plausible frames per second."""
MAX_CLIP_DURATION_S = 86_400.0
"""Time that a clip can take [s]."""
MAX_CAMERA_TRAVEL_M = 1000.0
"""Farthest position of a camera from its first one [m]."""
MAX_WORLD_DISTANCE_M = 1e5
"""Farthest position of a camera from the world's origin [m]: beyond, single precision does not hold a centimetre."""
MAX_HAND_OFFSET_M = 0.25
"""Largest distance of a hand's middle from the origin of the hand frame, which lies in the hand [m]."""


def check_clip(clip: Clip) -> None:
    """Raise ``InputError`` for what ``read_clip`` refuses in files: a clip may have been made of arrays instead."""
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


def check_hand(path: Path, hand: HandTrack) -> None:
    """Raise ``InputError`` for hands of no hand's size, away from the origin, inside out, or not before the camera."""
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


ASPECT_RATIO_TOLERANCE = 0.06
"""Largest difference of an image's shape from that of the clip's images: networks round sides to multiples of 14 or 32
pixels."""


def check_shape(
    path: Path, key: str, size: tuple[int, int], of_clip: tuple[int, int], stretch: float = ASPECT_RATIO_TOLERANCE
) -> None:
    """Raise ``InputError`` for images (width, height) of another shape than the clip's, as cropped or turned ones."""
    if min(size) < 1 or abs(math.log(size[0] / size[1] * of_clip[1] / of_clip[0])) > stretch:
        expected = f"the shape of the clip's images, {of_clip[0]} x {of_clip[1]}: neither cropped nor turned"
        raise InputError(path, key, f"{size[0]} x {size[1]} pixels", expected)


def check_intrinsics(path: Path, K: Float[ndarray, "T 3 3"], size: tuple[int, int]) -> None:
    """Raise ``InputError`` for matrices that are no pinhole's with square-on pixels, or not of such an image."""
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
    """Raise ``InputError`` for times [s] that do not rise, or that take longer than a clip can."""
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


def check_camera_poses(path: Path, T_world_cam: Float[ndarray, "T 4 4"], frames: Sequence[str]) -> None:
    """Raise ``InputError`` for motions that are not rigid, or that are too far from the origin or the first place."""
    with np.errstate(over="ignore", invalid="ignore"):
        rigid = se3.is_rigid(T_world_cam)
        apart = np.linalg.norm(T_world_cam[:, :3, 3] - T_world_cam[0, :3, 3], axis=1)
    if not rigid.all():
        bad = f"a matrix that is no rigid motion in frame {shorten_value(frames[int(np.argmin(rigid))])}"
        raise InputError(path, "camera.T_world_cam", bad, "rotations and translations [m], the last row 0 0 0 1")
    far = np.abs(T_world_cam[:, :3, 3]).max(axis=1)
    if not far.max() <= MAX_WORLD_DISTANCE_M:
        n = int(np.argmax(far))
        got = f"a camera {far[n]:.4g} m from the world's origin in frame {shorten_value(frames[n])}"
        expected = f"at most {MAX_WORLD_DISTANCE_M:g} m; subtract its first place from all, in metres"
        raise InputError(path, "camera.T_world_cam", got, expected)
    if not apart.max() <= MAX_CAMERA_TRAVEL_M:
        n = int(np.argmax(apart))
        got = f"a camera {apart[n]:.4g} m from its first place in frame {shorten_value(frames[n])}"
        raise InputError(path, "camera.T_world_cam", got, f"at most {MAX_CAMERA_TRAVEL_M:g} m; are these millimetres?")


def check_poses(
    path: Path, key: str, T_cam: Float[ndarray, "T 4 4"], centres: Float[ndarray, "T 3"], what: str
) -> None:
    """Raise ``InputError`` for motions that are not rigid, or that put a centre behind the camera or too far away."""
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
    """Raise ``InputError`` where points of a hand are not about the origin of its frame."""
    distance = np.linalg.norm(points.mean(axis=1), axis=1)
    if distance.max() > MAX_HAND_OFFSET_M:
        n = int(np.argmax(distance))
        got = f"{what} {distance[n]:.2g} m from the origin of the hand frame in frame {n}"
        expected = (
            f"at most {MAX_HAND_OFFSET_M:g} m; are these camera coordinates, to which T_cam_hand would apply again?"
        )
        raise InputError(path, key, got, expected)


def check_in_view(path: Path, hand: HandTrack, K: Float[ndarray, "T 3 3"], size: tuple[int, int]) -> None:
    """Raise ``InputError`` for a hand that is outside the image in every frame."""
    posed = se3.transform(hand.T_cam_hand, hand.vertices)
    before = posed[..., 2] > MIN_CAMERA_RANGE_M / 10.0
    uv = project(K, np.where(before[..., None], posed, [0.0, 0.0, 1.0]))
    low = np.where(before[..., None], uv, np.inf).min(axis=1)
    high = np.where(before[..., None], uv, -np.inf).max(axis=1)
    if not np.any(np.all((high > 0) & (low < size), axis=1)):
        centre = posed[:1].mean(axis=1, keepdims=True)
        u, v = project(K[:1], centre)[0, 0]
        where = (
            f"at u = {u:.0f}, v = {v:.0f} px" if centre[0, 0, 2] > 0 else f"{-centre[0, 0, 2]:.2g} m behind the camera"
        )
        got = f"a hand outside the image in every frame (in the first {where})"
        expected = f"a hand in the {size[0]} x {size[1]} image; do T_cam_hand and clip.json's camera belong together?"
        raise InputError(path, "T_cam_hand", got, expected)

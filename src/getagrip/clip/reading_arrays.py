"""The hands and the ground truth of a clip from their files, every number checked. Formats: docs/formats.md."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.clip.hand_track import FINGERS, HandTrack, OtherHand
from getagrip.clip.plausible import check_hand, check_in_hand, check_in_view, check_poses
from getagrip.clip.truth import Joint, Truth
from getagrip.errors import InputError
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import check_size
from getagrip.io import arrays, files

EXPECTED_HAND_FILE = "the hands of a clip, as getagrip import hands writes them"
OTHER_HAND_FILE = "other_hand.npz"
"""The hand of the other side, in a clip's folder."""
MAX_PALM_REGIONS, MAX_REGIONS_PER_VERTEX = 100, 8
"""Limits of a hand: areas of the palm, and the mean number of regions that a vertex is in."""
TRUTH_JOINT_KEYS = ("joint_moves", "joint_point", "joint_direction", "joint_angle")
"""Arrays of the truth about an articulated object's joint."""
MAX_HINGE_DISTANCE_M = 2.0
"""Plausible distance of a joint from the object's origin [m]."""


def frames_with_hand(path: Path, frames: tuple[str, ...]) -> Int[ndarray, "n"]:
    """Return the indices of the frames of a ``hand.npz``: those that it names, else all.

    Raises ``InputError``.

    Numbers instead of names are passed over: in a hand file they are those of the footage.
    """
    stored = arrays.read(path, {"frames"}.__contains__).get("frames", np.arange(0))
    if stored.dtype.kind != "U":
        return np.arange(len(frames))
    expected = "names of frames of the clip, in its order, each once"
    try:
        names = [str(name) for name in stored.ravel()]
    except ValueError as error:  # code points that do not exist
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
    seen = _parse_joints_2d(path, stored, frames) if "joints_2d" in stored else (None, None)
    hand = HandTrack(
        vertices, faces, T_cam_hand, _parse_contact_regions(path, stored, vertices.shape[1]), joints, *seen
    )
    check_hand(path, hand)
    return hand


def _parse_joints_2d(
    path: Path, stored: dict[str, ndarray], frames: int
) -> tuple[Float[ndarray, "T 21 2"], Float[ndarray, "T 21"]]:
    """Joints as seen in the images, and their confidence; 1 where the file does not say."""
    points = arrays.floats(path, stored, "joints_2d", (frames, 21, 2))
    if "joints_2d_confidence" not in stored:
        return points, np.ones((frames, 21))
    confidence = arrays.floats(path, stored, "joints_2d_confidence", (frames, 21))
    if confidence.min(initial=0.0) < 0.0 or confidence.max(initial=0.0) > 1.0:
        bad = f"numbers from {confidence.min():.3g} to {confidence.max():.3g}"
        raise InputError(path, "joints_2d_confidence", bad, "0 to 1")
    return points, confidence


def _parse_contact_regions(path: Path, stored: dict[str, ndarray], count: int) -> dict[str, Int[ndarray, "_"]]:
    """Contact regions of a hand; they cannot be found from a bare mesh."""
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
    """Read the hand of the other side in the clip's frames ``rows``, where there is a file of it.

    Raises ``InputError``.
    """
    path = folder / OTHER_HAND_FILE
    if not path.exists() and not path.is_symlink():
        return None
    path = files.inside(folder, OTHER_HAND_FILE, "", EXPECTED_HAND_FILE)
    there = frames_with_hand(path, frames)
    hand = read_hand(path, len(there))
    _, here, found = np.intersect1d(rows, there, return_indices=True)
    if not len(here):
        expected = "the hand in one of the frames at least in which hand.npz has the clip's own"
        raise InputError(path, "frames", f"{len(there)} frames, and none of these", expected)
    check_in_view(path, hand.take(found), K[here], size)
    return OtherHand.at(hand.take(found), here, len(rows))


def read_truth(folder: Path, hand: HandTrack, scale: str, mesh: Mesh) -> Truth:
    """Read a clip's ``truth.npz``; what it leaves out is the clip's own. Raises ``InputError``."""
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
    """Parse the joint of an articulated object; it needs the articulation of each frame, too."""
    missing = next((key for key in ("articulation", *TRUTH_JOINT_KEYS) if key not in stored), None)
    if missing is not None:
        raise InputError(
            path, missing, "no such array", f"all of articulation, {', '.join(TRUTH_JOINT_KEYS)}, or none of the last"
        )
    moves = stored["joint_moves"]
    if moves.dtype != bool or moves.shape != (len(mesh.vertices),):
        expected = f"true or false for each of the {len(mesh.vertices)} vertices of the mesh"
        raise InputError(path, "joint_moves", f"{moves.dtype} of shape {moves.shape}", expected)
    point, direction = (arrays.floats(path, stored, key, (3,)) for key in ("joint_point", "joint_direction"))
    if not np.linalg.norm(point) < MAX_HINGE_DISTANCE_M:
        input_point = f"a point {np.linalg.norm(point):.4g} m from the object's origin"
        raise InputError(
            path, "joint_point", input_point, f"less than {MAX_HINGE_DISTANCE_M:g} m; are these millimetres?"
        )
    if abs(np.linalg.norm(direction) - 1.0) > 1e-6:
        raise InputError(
            path, "joint_direction", f"the length {np.linalg.norm(direction):g}", "a direction of length 1"
        )
    angle = float(arrays.floats(path, stored, "joint_angle", ()))
    if abs(angle) > 2.0 * np.pi:
        raise InputError(path, "joint_angle", f"{angle:g}", "at most a full turn [rad]; are these degrees?")
    return Joint(moves, point, direction, angle)

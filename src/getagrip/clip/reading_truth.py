"""The ground truth of a clip from its file, every number checked. The format is in docs/formats.md."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy import ndarray

from getagrip.clip.hand_track import HandTrack
from getagrip.clip.plausible import check_in_hand, check_poses
from getagrip.clip.truth import Joint, Truth
from getagrip.errors import InputError
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import check_size
from getagrip.io import arrays, files

JOINT = ("joint_moves", "joint_point", "joint_direction", "joint_angle")
"""Arrays of the truth about an articulated object's joint."""
FARTHEST_JOINT = 2.0
"""Plausible distance of a joint from the object's origin [m]."""


def read_truth(folder: Path, hand: HandTrack, scale: str, mesh: Mesh) -> Truth:
    """Read a clip's ``truth.npz``; what it leaves out is the clip's own. Raises ``InputError``."""
    path = files.inside(folder, "truth.npz", "", "the truth of a clip")
    named = ("T_cam_obj", "scale", "T_cam_hand", "hand_vertices", "articulation", *JOINT)
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
    joint = _joint(path, stored, mesh) if any(key in stored for key in JOINT) else None
    return Truth(T_cam_obj, size, T_cam_hand, vertices, articulation, joint)


def _joint(path: Path, stored: dict[str, ndarray], mesh: Mesh) -> Joint:
    """Parse the joint of an articulated object; it needs the articulation of each frame, too."""
    missing = next((key for key in ("articulation", *JOINT) if key not in stored), None)
    if missing is not None:
        raise InputError(
            path, missing, "no such array", f"all of articulation, {', '.join(JOINT)}, or none of the last"
        )
    moves = stored["joint_moves"]
    if moves.dtype != bool or moves.shape != (len(mesh.vertices),):
        expected = f"true or false for each of the {len(mesh.vertices)} vertices of the mesh"
        raise InputError(path, "joint_moves", f"{moves.dtype} of shape {moves.shape}", expected)
    point, direction = (arrays.floats(path, stored, key, (3,)) for key in ("joint_point", "joint_direction"))
    if not np.linalg.norm(point) < FARTHEST_JOINT:
        input_point = f"a point {np.linalg.norm(point):.4g} m from the object's origin"
        raise InputError(path, "joint_point", input_point, f"less than {FARTHEST_JOINT:g} m; are these millimetres?")
    if abs(np.linalg.norm(direction) - 1.0) > 1e-6:
        raise InputError(
            path, "joint_direction", f"the length {np.linalg.norm(direction):g}", "a direction of length 1"
        )
    angle = float(arrays.floats(path, stored, "joint_angle", ()))
    if abs(angle) > 2.0 * np.pi:
        raise InputError(path, "joint_angle", f"{angle:g}", "at most a full turn [rad]; are these degrees?")
    return Joint(moves, point, direction, angle)

"""EPIC-Fields: where the camera of a video was in each frame, and the similarity that makes its world metric.

``<video>.json`` has ``images``: a frame's name to the world-to-camera rotation as a quaternion (w, x, y, z) and
translation, in a scale of its own. The authors of EPIC-HIT publish a similarity for each of their videos, another
``<video>.json``: ``{"T": [[sR | t], ...]}``, into a world in metres whose gravity is -z.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.io import arrays, json_stream
from getagrip.io.files import printable, read_json, shorten_value

EPIC_WORLD_UP = np.array([0.0, 0.0, 1.0])
"""In the metric world."""
METRIC_SCALE_RANGE = 1e-4, 1e4
"""Metres in a unit of EPIC-Fields' world."""
MAX_ROTATION_DEVIATION = 1e-3
"""Largest deviation of a similarity from a rotation, times its scale."""
MAX_EPIC_POSITION_M = 1e3
"""No camera is farther from the origin [m]."""
EPIC_FIELDS_FRAME_PATTERN = re.compile(r"frame_(\d{1,10})\.jpg")


def read_metric_similarity(path: Path) -> tuple[float, Float[ndarray, "4 4"]]:
    """Scale s and motion (R, t) of a similarity: a point of EPIC-Fields' world is at s R x + t [m].

    Raises ``InputError``.
    """
    content = read_json(path)
    value = content.get("T") if isinstance(content, dict) else content
    T = arrays.from_lists(value) if isinstance(value, list) else None
    if T is None or T.shape != (4, 4) or T.dtype.kind not in "fi" or not np.isfinite(T.astype(float)).all():
        raise InputError(path, "T", shorten_value(value), "a 4x4 matrix [sR | t], a similarity into metres")
    T = T.astype(float)
    scale = float(np.cbrt(np.linalg.det(T[:3, :3])))
    rigid = T.copy()
    rigid[:3, :3] /= scale if scale > 0.0 else 1.0
    off = np.abs(rigid[:3, :3] @ rigid[:3, :3].T - np.eye(3)).max()
    if (
        not METRIC_SCALE_RANGE[0] < scale < METRIC_SCALE_RANGE[1]
        or off > MAX_ROTATION_DEVIATION
        or not np.allclose(T[3], [0.0, 0.0, 0.0, 1.0])
    ):
        raise InputError(path, "T", f"a scale of {scale:.3g}, {off:.2g} from a rotation", "a similarity [sR | t]")
    U, _, Vt = np.linalg.svd(rigid[:3, :3])
    return scale, se3.rigid(U @ Vt, rigid[:3, 3])


def read_epic_camera_poses(
    path: Path, scale: float, T_metric_world: Float[ndarray, "4 4"], wanted: range
) -> Mapping[int, Float[ndarray, "4 4"]]:
    """Read ``T_world_cam`` in the metric world by EPIC's frame numbers: of those ``wanted`` that EPIC-Fields has.

    Raises ``InputError``.
    """
    found = {}
    for name, value in json_stream.stream_entries(path, "images"):
        number = EPIC_FIELDS_FRAME_PATTERN.fullmatch(name)
        if number is None:
            raise InputError(path, f"images.{printable(name)}", "this name", "a frame's, as frame_0000000001.jpg")
        if int(number[1]) not in wanted:
            continue
        q_t = arrays.from_lists(value) if isinstance(value, list) else None
        if q_t is None or q_t.shape != (7,) or q_t.dtype.kind not in "fi" or not _is_quaternion_pose(q_t.astype(float)):
            raise InputError(
                path, f"images.{printable(name)}", shorten_value(value), "[qw, qx, qy, qz, tx, ty, tz], |q| = 1"
            )
        T_cam_world = se3.rigid(se3.from_quaternion(q_t[:4].astype(float)), q_t[4:].astype(float))
        T_world_cam = se3.inverse(T_cam_world)
        T_world_cam[:3, 3] *= scale
        T = T_metric_world @ T_world_cam
        if np.linalg.norm(T[:3, 3]) > MAX_EPIC_POSITION_M:
            raise InputError(path, f"images.{printable(name)}", f"a camera {np.linalg.norm(T[:3, 3]):.3g} m away",
                             f"at most {MAX_EPIC_POSITION_M:g} m")  # fmt: skip
        found[int(number[1])] = np.asarray(T)
    return found


def _is_quaternion_pose(q_t: Float[ndarray, "7"]) -> bool:
    return bool(np.isfinite(q_t).all() and abs(np.linalg.norm(q_t[:4]) - 1.0) < 1e-2)

"""The camera's path from other programs' files: ``read_path(path)``, recognised by names and keys.

Each format is a function in one of these files, and a line in ``CAMERA_FORMATS``; it returns None for what is not its own.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from getagrip.errors import InputError, UsageError
from getagrip.io import arrays
from getagrip.readers.cameras import colmap, phones, slam, transforms
from getagrip.readers.cameras.camera_path import CameraPath

__all__ = ["CAMERA_FORMATS", "CameraPath", "read_camera_path"]

CAMERA_FORMATS: dict[str, Callable[[Path], CameraPath | None]] = {
    "colmap (images.txt or images.bin, cameras.txt or cameras.bin)": colmap.read_colmap,
    "epic-fields (a JSON with camera and images)": colmap.read_epic_fields,
    "vipe (pose/*.npz and intrinsics/*.npz)": slam.read_vipe,
    "megasam (cam_c2w in an .npz)": slam.read_megasam,
    "hawor (SLAM/hawor_slam_w_scale_*.npz, or traj in an .npz, as of DROID-SLAM)": slam.read_hawor,
    "nerfstudio (transforms.json, as of Polycam, too)": transforms.read_nerfstudio,
    "record3d (metadata.json)": transforms.read_record3d,
    "arkit (frames' .json with cameraPoseARFrame)": phones.read_arkit,
    "aria (closed_loop_trajectory.csv)": phones.read_aria,
    "tum (lines of 8 numbers)": slam.read_tum,
    "kitti (lines of 12 numbers)": slam.read_kitti,
}


def read_camera_path(path: Path, quaternion: str = "") -> CameraPath:
    """Read a camera's path, in whatever format it is.

    ``quaternion``, ``xyzw`` or ``wxyz``, is the order of those in lines of numbers, where the user states it. Raises
    ``InputError`` for damaged files and where no format fits, ``UsageError`` where several do.
    """
    if not path.exists():
        raise InputError(path, "", "no such file or folder", "a camera's path")
    lines = {
        name: partial(slam.read_tum, quaternion=quaternion)
        for name in CAMERA_FORMATS
        if CAMERA_FORMATS[name] is slam.read_tum
    }
    with arrays.convert_to_input_errors(path):
        found = {name: one for name, read in (CAMERA_FORMATS | lines).items() if (one := read(path)) is not None}
    if quaternion and not {*lines} & {*found}:
        raise UsageError(f"--quaternion cannot be used with {path}: it has no lines of quaternions")
    if len(found) > 1:
        raise UsageError(f"{path}: may be of several programs ({', '.join(found)}); name the file")
    if not found:
        expected = f"one of {', '.join(CAMERA_FORMATS)}; other paths can be written as lines of time x y z qx qy qz qw"
        raise InputError(path, "", "files of no known program", expected)
    return next(iter(found.values()))

"""Camera trajectories from other programs' files, recognised by names and keys: ``read_camera_path(path)``.

Each format is a function in a file of this folder, which returns None for other formats, and a line in
``CAMERA_FORMATS``.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from getagrip.errors import InputError, UsageError
from getagrip.io import arrays
from getagrip.readers.cameras import capture_apps, colmap, slam
from getagrip.readers.cameras.camera_path import CameraPath

__all__ = ["CAMERA_FORMATS", "CameraPath", "read_camera_path"]

CAMERA_FORMATS: dict[str, Callable[[Path], CameraPath | None]] = {
    "colmap (images.txt or images.bin, cameras.txt or cameras.bin)": colmap.read_colmap,
    "epic-fields (a JSON with camera and images)": colmap.read_epic_fields,
    "vipe (pose/*.npz and intrinsics/*.npz)": slam.read_vipe,
    "megasam (cam_c2w in an .npz)": slam.read_megasam,
    "hawor (SLAM/hawor_slam_w_scale_*.npz, or traj in an .npz, as of DROID-SLAM)": slam.read_hawor,
    "nerfstudio (transforms.json, as of Polycam, too)": capture_apps.read_nerfstudio,
    "record3d (metadata.json)": capture_apps.read_record3d,
    "arkit (frames' .json with cameraPoseARFrame)": capture_apps.read_arkit,
    "aria (closed_loop_trajectory.csv)": capture_apps.read_aria,
    "tum (lines of 8 numbers)": slam.read_tum,
    "kitti (lines of 12 numbers)": slam.read_kitti,
}


def read_camera_path(path: Path, quaternion: str = "") -> CameraPath:
    """Read a camera trajectory in any known format.

    ``quaternion``, ``xyzw`` or ``wxyz``, is the user's order of quaternions in lines of numbers. Raises ``InputError``
    for malformed files and unknown formats, ``UsageError`` where several formats fit.
    """
    if not path.exists():
        raise InputError(path, "", "no such file or folder", "a camera's path")
    lines = {key: partial(read, quaternion=quaternion) for key, read in CAMERA_FORMATS.items() if read is slam.read_tum}
    with arrays.convert_to_input_errors(path):
        found = {name: one for name, read in (CAMERA_FORMATS | lines).items() if (one := read(path)) is not None}
    if quaternion and not {*lines} & {*found}:
        raise UsageError(f"--quaternion cannot be used with {path}: it has no lines of quaternions")
    if len(found) > 1:
        raise UsageError(f"{path}: several formats fit ({', '.join(found)}); name the file")
    if not found:
        expected = f"one of {', '.join(CAMERA_FORMATS)}; other paths can be written as lines of time x y z qx qy qz qw"
        raise InputError(path, "", "files of no known program", expected)
    return next(iter(found.values()))
